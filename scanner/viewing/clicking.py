"""Measuring by clicking on points, and setting the scale of the configuration by two whose distance is known."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np
import viser

from calib.geometry import Calibration
from calib.numerics import Floats
from scanner.measuring import DistanceMeasurement, PlacedPoints, PointNumber, angle_cells
from scanner.quantities import shown_unit
from scanner.shown_text import unbroken
from scanner.viewing.buttons import PLAIN
from scanner.viewing.result import ViewedCloud
from scanner.viewing.scene import CloudScene
from scanner.viewing.texts import bold, escaped
from scanner.viewing.view_controls import failures_shown

_LARGEST_SHARE = 0.2  # largest share of a length that its sigma may have in a configuration
_MM = 1000.0


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


SetScale = Callable[[KnownScale], str]


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


# Largest angle between a picked point and the ray of a click: about eight pixels of a window.
_REACH_RAD = 0.008
# Of two points within reach the nearer one is picked, unless it is about as close to the other.
_SAME_DEPTH = 0.02
_MOST = 3


def point_at(points: Floats, origin: Floats, direction: Floats) -> int | None:
    """The number of the point (N, 3) that a ray from `origin` (3,) meets first; None if it passes all by."""
    towards = direction / np.linalg.norm(direction)
    apart = points - origin
    depth = apart @ towards
    beside = np.sqrt(np.maximum(np.einsum("ni,ni->n", apart, apart) - depth**2, 0.0))
    within = np.flatnonzero((depth > 0) & (beside <= _REACH_RAD * depth))
    if not len(within):
        return None
    front = within[depth[within] <= (1 + _SAME_DEPTH) * depth[within].min()]
    return int(front[np.argmin(beside[front] / depth[front])])


@dataclass(frozen=True)
class Picked:
    """Points of scans in the order of the clicks."""

    scans: PlacedPoints
    points: tuple[PointNumber, ...] = ()

    def with_point(self, point: PointNumber) -> "Picked":
        """Add a point. After three points, or at a point that is already picked, start again with this one."""
        begins = len(self.points) == _MOST or point in self.points
        return Picked(self.scans, (point,) if begins else (*self.points, point))

    @property
    def places(self) -> Floats:
        """The positions of the points in the cloud's frame, (n, 3)."""
        return np.reshape([self.scans.position(point) for point in self.points], (-1, 3))

    @property
    def distance(self) -> DistanceMeasurement | None:
        """Between two points; None unless there are two."""
        match self.points:
            case (first, second):
                return self.scans.distance((first, second))
        return None

    def scale(self, known_m: float, sigma_m: float) -> KnownScale | None:
        """Return the scale that makes their distance `known_m`; None unless there are two points, precise enough."""
        distance = self.distance
        return None if distance is None else scale_from(distance, self.scans.errors.calibration, known_m, sigma_m)

    def text(self) -> str:
        """Describe the measurement (Markdown)."""
        unit = shown_unit(self.scans.unit)
        match self.points:
            case ():
                return "Click on a point of the cloud; on two for a distance, on three for the angle at the second."
            case (one,):
                x, y, z = (unit.number(float(value)) for value in self.scans.position(one))
                return f"{self.scans.name(one).capitalize()}: x {x}, y {y}, z {z} {unit.name}"
            case (first, second):
                distance = self.scans.distance((first, second))
                sigma = distance.budget.sigma if distance.budget else None
                return f"Distance: **{unit.length(distance.distance, sigma)}**"
            case (first, second, third):
                angle, sigma_cell = angle_cells(self.scans.angle((first, second, third)))
                return f"Angle: **{angle} {sigma_cell}**"
        raise ValueError(f"{len(self.points)} points selected: expected one, two or three")


class Clicking:
    """Measuring by clicks, with controls in the GUI container that is open on creation; `set_scale` stores a scale and
    confirms it.
    """

    def __init__(self, gui: viser.GuiApi, scene: CloudScene, cloud: ViewedCloud, set_scale: SetScale | None) -> None:
        self._scene, self._set_scale = scene, set_scale
        self._lock = Lock()
        self._cloud = cloud
        self._picked = None if cloud.scans is None else Picked(cloud.scans)
        self._measured = gui.add_markdown("This cloud has no scans to measure in.")
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
            point = point_at(self._cloud.points, origin, direction)
            if point is not None:
                self._show(self._picked.with_point(self._cloud.point_number(point)))

    def _forget(self) -> None:
        with self._lock:
            if self._picked is not None:
                self._show(Picked(self._picked.scans))

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
