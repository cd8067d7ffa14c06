"""Measuring by clicking on points, and setting the scale by two whose distance is known."""

from collections.abc import Callable
from threading import Lock

import viser

from calib.numerics import Floats
from scanner.shown_text import unbroken
from scanner.viewing.buttons import PLAIN
from scanner.viewing.picking import KnownScale, Picked, point_at
from scanner.viewing.result import ViewedCloud
from scanner.viewing.scene import CloudScene
from scanner.viewing.texts import bold, escaped
from scanner.viewing.view_controls import failures_shown

_MM = 1000.0

SetScale = Callable[[KnownScale], str]


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
