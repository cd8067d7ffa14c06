"""Controls of the 3-D view: points or triangles, colours, and the part of the cloud."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import viser

from scanner.quantities import shown_unit
from scanner.ui import failure_of
from scanner.viewing.buttons import PLAIN
from scanner.viewing.colouring import ColourBar, Colouring, possible_colourings
from scanner.viewing.crop import Box, box_within, frame_of, write_cropped
from scanner.viewing.decimation import DEFAULT_SHOWN, many, statement
from scanner.viewing.result import CaptureCloud, ViewedCloud
from scanner.viewing.scene import FACES, PARTS, RIGS, CloudScene, SurfaceMesh, ViewSummary, surface_of
from scanner.viewing.texts import bar_html, bold
from scanner.viewing.windows import LABELS

_PARTS = {"Devices": RIGS, "Faces, ruler": FACES, "Labels": LABELS}
_WHOLE_PERCENT = 100
_POINTS, _SURFACE = "Points", "Surface"
_STEPS = 200  # least number of steps in a range


@contextmanager
def failures_shown(message: viser.GuiMarkdownHandle) -> Iterator[None]:
    """If what is done within fails, the message says why, and the page goes on."""
    try:
        yield
    except Exception as error:
        message.content = bold(failure_of(error).message)


class ViewControls:
    """The controls of one cloud, in the GUI container that is open on creation; `name` is used for files of a part of
    it. `keep` makes the box a step of the result. `legend`: the title and the bar of the colours that are shown.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        scene: CloudScene,
        cloud: ViewedCloud,
        name: str,
        keep: Callable[[Box], None] | None = None,
    ) -> None:
        self._gui, self._scene, self._cloud, self._name = gui, scene, cloud, name
        self._lock = Lock()
        self._drawn: object = None
        self.legend: tuple[str, ColourBar | None] = ("", None)
        self._surface: SurfaceMesh | None = None
        self._frame = frame_of(cloud)
        self._shown_as = gui.add_dropdown(
            "Show", [_POINTS, _SURFACE], visible=isinstance(cloud, CaptureCloud), hint="The surface: triangles"
        )
        self._colouring = gui.add_dropdown("Colour", [colouring.value for colouring in possible_colourings(cloud)])
        self._bar = gui.add_html("")
        percent = max(1, min(_WHOLE_PERCENT, round(_WHOLE_PERCENT * DEFAULT_SHOWN / len(cloud.points))))
        self._percent = gui.add_slider("Points, %", min=1, max=_WHOLE_PERCENT, step=1, initial_value=percent)
        self._statement = gui.add_markdown("")
        for kind, part in PARTS.items():
            lacking = None if kind in scene.kinds else f"No {kind.value.lower()} was recognised in this cloud."
            self._add_part(kind.value, part, lacking)
        for label, part in _PARTS.items():
            self._add_part(label, part)
        gui.add_button("Back to the first view", color=PLAIN).on_click(lambda _: scene.look())
        with gui.add_folder("Cut out a part", expand_by_default=False):
            gui.add_markdown("Of each, from where to where:")
            self._ends = [self._range(axis) for axis in range(3)]
            self._ranges = [
                gui.add_vector2(f"{name}, {shown_unit(cloud.unit).name}", ends)
                for name, ends in zip(self._frame.names, self._ends, strict=True)
            ]
            gui.add_button("The whole again", color=PLAIN).on_click(lambda _: self._uncut())
            gui.add_button("Download this part", color=PLAIN).on_click(self._download)
            if keep is not None:
                hint = "A step of the result: every export and view shows this part, until the step is taken back"
                button = gui.add_button("Keep only this part", color=PLAIN, hint=hint)
                button.on_click(lambda _: self._keep(keep))
            self._message = gui.add_markdown("")
        for control in (self._shown_as, self._colouring, self._percent, *self._ranges):
            control.on_update(lambda _: self.draw())

    @property
    def box(self) -> Box:
        """The crop box."""
        chosen = np.array([field.value for field in self._ranges])
        # An unchanged end of a range is that of the cloud, regardless of rounding.
        whole = np.stack([self._frame.low, self._frame.high], axis=1)
        factor = shown_unit(self._cloud.unit).factor
        return box_within(self._frame, np.where(chosen == np.array(self._ends), whole, chosen / factor))

    def draw(self) -> None:
        """Draw it as the controls are now; of many changes in a row, those that are outdated are skipped."""
        with self._lock:
            colouring, share, box = Colouring(self._colouring.value), self._percent.value / _WHOLE_PERCENT, self.box
            as_surface = self._shown_as.value == _SURFACE
            wanted = (as_surface, colouring, share, box.low.tolist(), box.high.tolist())
            if wanted == self._drawn:
                return
            self._statement.content = "Drawing …"
            with failures_shown(self._statement):
                self._scene.draw_box(box)
                drawn = self._draw(colouring, share, box, as_surface=as_surface)
                self._drawn = wanted
                self._percent.disabled = as_surface
                self.legend = (colouring.value, drawn.coloured.bar)
                self._bar.content = bar_html(*self.legend)
                self._statement.content = f"{self._how_many(drawn, box)} {drawn.coloured.legend}"

    def _draw(self, colouring: Colouring, share: float, box: Box, *, as_surface: bool) -> ViewSummary:
        if not (as_surface and isinstance(self._cloud, CaptureCloud)):
            return self._scene.draw_points(share, colouring, box)
        self._surface = self._surface or surface_of(self._cloud)
        return self._scene.draw_surface(self._surface, colouring, box)

    def _how_many(self, drawn: ViewSummary, box: Box) -> str:
        if self._shown_as.value == _SURFACE:
            return f"Showing {many(drawn.triangles)} triangles."
        part = f", of {many(len(self._cloud.points))} in all" if box.bounded else ""
        return f"{statement(drawn.points, drawn.among).capitalize()}{part}."

    def _add_part(self, label: str, part: str, lacking: str | None = None) -> None:
        """A box for it; `lacking` says why it cannot be used."""
        box = self._gui.add_checkbox(label, initial_value=lacking is None, disabled=lacking is not None, hint=lacking)
        box.on_update(lambda _: self._scene.set_visible(part, box.value))

    def _range(self, axis: int) -> tuple[float, float]:
        """Return the range of the cloud along an axis, rounded outwards to round numbers of the displayed unit."""
        low, high = (
            shown_unit(self._cloud.unit).factor * float(end[axis]) for end in (self._frame.low, self._frame.high)
        )
        step = float(10.0 ** np.floor(np.log10(max(high - low, 1e-9) / _STEPS)))
        digits = max(0, -int(np.floor(np.log10(step))))
        return round(float(np.floor(low / step) * step), digits), round(float(np.ceil(high / step) * step), digits)

    def _uncut(self) -> None:
        for field, ends in zip(self._ranges, self._ends, strict=True):
            field.value = ends
        self.draw()

    def _keep(self, keep: Callable[[Box], None]) -> None:
        with failures_shown(self._message):
            keep(self.box)

    def _download(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is None:
            return
        with failures_shown(self._message), tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"{self._name}-part.ply")
            count = write_cropped(path, self._cloud, self.box)
            event.client.send_file_download(path.name, path.read_bytes(), save_immediately=True)
            self._message.content = f"{many(count)} points, as {path.name}."
