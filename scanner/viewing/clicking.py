"""Measuring by clicking on points, and setting the scale of the configuration by two whose distance is known."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np
import viser

from calib.geometry import Calibration
from calib.numerics import Floats
from scanner.measuring import DistanceMeasurement
from scanner.shown_text import unbroken
from scanner.viewing.picking import Picked, point_at
from scanner.viewing.result import CaptureCloud, ViewedCloud
from scanner.viewing.scene import Scene
from scanner.viewing.texts import bold, escaped
from scanner.viewing.view_controls import PLAIN, failures_shown

_LARGEST_SHARE = 0.2  # largest share of a length that its sigma may have in a configuration


@dataclass(frozen=True)
class KnownScale:
    """`scale.baseline_m` and `scale.sigma_m` of a configuration: the baseline that makes a measured distance as long as
    it is known to be.
    """

    baseline_m: float
    sigma_m: float

    @property
    def keys(self) -> dict[str, float]:
        """Return the scale as keys of the configuration file."""
        return {"scale.baseline_m": float(f"{self.baseline_m:.7g}"), "scale.sigma_m": float(f"{self.sigma_m:.3g}")}

    @property
    def line(self) -> str:
        """Return the scale as a line of the configuration file."""
        baseline_m, sigma_m = self.keys.values()
        return f"scale: {{baseline_m: {baseline_m}, sigma_m: {sigma_m}}}"


def scale_from(
    distance: DistanceMeasurement, calibration: Calibration, known_m: float, sigma_m: float
) -> KnownScale | None:
    """Return the scale from two points whose distance is `known_m` ± `sigma_m`; None if the points are too uncertain.

    The scan measures the baseline relative to the distance, in any unit: the sigma does not include that of the present
    scale.
    """
    baseline_m = calibration.baseline / distance.distance * known_m
    budget = distance.budget
    measured = 0.0 if budget is None else np.sqrt(budget.sigma**2 - budget.scale**2) / distance.distance
    relative = float(np.hypot(measured, sigma_m / known_m))
    return KnownScale(baseline_m, relative * baseline_m) if relative < _LARGEST_SHARE else None


_MM = 1000.0

SetScale = Callable[[KnownScale], str]


class Clicking:
    """Measuring by clicks, with controls in the GUI container that is open on creation; `set_scale` stores a scale and
    confirms it.
    """

    def __init__(self, gui: viser.GuiApi, scene: Scene, cloud: ViewedCloud, set_scale: SetScale | None) -> None:
        self._scene, self._set_scale = scene, set_scale
        self._lock = Lock()
        self._picked = Picked(cloud) if isinstance(cloud, CaptureCloud) else None
        self._measured = gui.add_markdown("In the cloud of one capture: choose it above.")
        if self._picked is None:
            return
        gui.add_button("Forget the points", color=PLAIN).on_click(lambda _: self._forget())
        self._known = gui.add_folder("Set the scale by these two points", visible=False)
        with self._known:
            self._length = gui.add_number("Known distance, mm", 0.0, min=0.0, max=1e6, step=0.01)
            self._sigma = gui.add_number("± of it, mm", 0.0, min=0.0, max=1e5, step=0.01)
            self._message = gui.add_markdown("")
            self._write = gui.add_button("Write it into the configuration", visible=False, color=PLAIN)
        self._length.on_update(lambda _: self._show_scale())
        self._sigma.on_update(lambda _: self._show_scale())
        self._write.on_click(lambda _: self._write_scale())
        self._show(self._picked)

    def pick(self, origin: Floats, direction: Floats) -> None:
        """A click: the point under it is measured from, or to."""
        with self._lock:
            if self._picked is None:
                return
            point = point_at(self._picked.cloud.points, origin, direction)
            if point is not None:
                self._show(self._picked.with_point(point))

    def _forget(self) -> None:
        with self._lock:
            if self._picked is not None:
                self._show(Picked(self._picked.cloud))

    def _show(self, picked: Picked) -> None:
        self._picked = picked
        self._measured.content = unbroken(picked.text())
        self._scene.draw_picked(picked.places)
        self._known.visible = picked.distance is not None
        self._show_scale()

    def _scale(self) -> KnownScale | None:
        if self._picked is None or not self._length.value > 0:
            return None
        return self._picked.scale(self._length.value / _MM, self._sigma.value / _MM)

    def _show_scale(self) -> None:
        scale = self._scale()
        self._write.visible = scale is not None and self._set_scale is not None
        if scale is not None:
            self._message.content = (
                f"`{scale.line}` in the configuration makes this distance {self._length.value:g} mm, in every scan of "
                "this rig, and in this one when it is calibrated again (`scan calibrate`)."
            )
        elif self._length.value > 0:
            self._message.content = bold("These two points are too uncertain to set the scale.")
        else:
            self._message.content = "Use two points that are far apart."

    def _write_scale(self) -> None:
        if (scale := self._scale()) is not None and self._set_scale is not None:
            with failures_shown(self._message):
                self._message.content = escaped(self._set_scale(scale))
