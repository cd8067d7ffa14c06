"""Beside the 3-D view: what it shows, what the result says of itself, and the controls for both."""

from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any

import viser

from calib.numerics import Floats
from scanner.results import CALIBRATION_FILE, CLOUD_FILE, MERGED_FILE, REFUSAL_FILE, REPORT_FILE, read_verdict
from scanner.ui import failure_of
from scanner.viewing.colouring import Colouring, possible_colourings
from scanner.viewing.decimation import DEFAULT_SHOWN, statement
from scanner.viewing.picking import Picked, point_at
from scanner.viewing.result import CaptureCloud, ViewedCloud, ViewedResult
from scanner.viewing.scene import FACES, LABELS, RIGS, Scene
from scanner.viewing.texts import calibration_text, corner_text, escaped, verdict_text

_PARTS = {"Devices": RIGS, "Faces, ruler": FACES, "Names": LABELS}
_WHOLE_PERCENT = 100


class ResultPanel:
    """Shows one result at a time, in the scene and as controls and text where `place` is."""

    def __init__(self, server: viser.ViserServer, place: viser.GuiTabHandle) -> None:
        self._gui = server.gui
        self._scene = Scene(server)
        self._place = place
        self._lock = Lock()
        self._parts: list[viser.GuiFolderHandle] = []
        self._drawn: tuple[ViewedCloud, int, Colouring] | None = None
        self._picked: Picked | None = None
        self._scene.on_click(self._pick)

    def close(self) -> None:
        """Show no result."""
        with self._lock:
            self._remove()
            self._scene.clear()

    def open(self, result: ViewedResult) -> None:
        """Show a result in place of the last one. Raises InputError if a file is missing or damaged."""
        cloud = result.cloud(result.names[0])  # before anything is removed: a damaged result replaces nothing
        with self._lock, self._place:
            self._remove()
            with self._folder(f"Result: {result.folder.name or result.folder}"):
                self._gui.add_markdown(verdict_text(result.verdict))
                self._add_downloads(result.folder)
            with self._folder("View"):
                self._add_view(result, cloud)
            with self._folder("Measure by clicking"):
                self._measured = self._gui.add_markdown("")
                self._gui.add_button("Forget the points").on_click(lambda _: self._pick_anew())
            with self._folder("Calibration, ± one standard deviation"):
                self._gui.add_markdown(calibration_text(result.calibration, result.truth))
            with self._folder("Faces"):
                self._faces = self._gui.add_markdown("")
        self._show(cloud)

    def open_refused(self, folder: Path) -> None:
        """Show why a capture was refused, in place of the last result. Raises InputError."""
        verdict = read_verdict(folder / REFUSAL_FILE)
        with self._lock, self._place:
            self._remove()
            self._scene.clear()
            with self._folder(f"Result: {folder.name}"):
                self._gui.add_markdown(verdict_text(verdict))
                self._add_downloads(folder)

    def _add_downloads(self, folder: Path) -> None:
        for name in (REPORT_FILE, CALIBRATION_FILE, MERGED_FILE, CLOUD_FILE):
            if (folder / name).is_file():
                self._gui.add_button(f"Download {name}").on_click(_sending(folder / name))

    def _remove(self) -> None:
        for part in self._parts:
            part.remove()
        self._parts = []
        self._drawn = self._picked = None

    def _folder(self, label: str) -> viser.GuiFolderHandle:
        self._parts.append(self._gui.add_folder(label))
        return self._parts[-1]

    def _add_view(self, result: ViewedResult, cloud: ViewedCloud) -> None:
        if len(result.names) > 1:
            self._name = self._gui.add_dropdown("Cloud", result.names, initial_value=result.names[0])
            self._name.on_update(lambda _: self._show_another(result))
        self._colouring = self._gui.add_dropdown("Colour", [Colouring.CAMERA.value])
        self._percent = self._gui.add_slider(
            "Points, %", min=1, max=_WHOLE_PERCENT, step=1, initial_value=_first_percent(cloud)
        )
        self._statement = self._gui.add_markdown("")
        self._colouring.on_update(lambda _: self._redraw())
        self._percent.on_update(lambda _: self._redraw())
        for label, part in _PARTS.items():
            box = self._gui.add_checkbox(label, initial_value=True)
            box.on_update(self._toggling(part, box))
        self._gui.add_button("Back to the first view").on_click(lambda _: self._scene.look())

    def _toggling(self, part: str, box: viser.GuiCheckboxHandle) -> Callable[[object], None]:
        return lambda _: self._scene.set_visible(part, box.value)

    def _show_another(self, result: ViewedResult) -> None:
        self._statement.content = "Reading …"
        try:
            cloud = result.cloud(self._name.value)
        except Exception as error:
            self._statement.content = f"**{escaped(failure_of(error).message)}**"
            return
        self._show(cloud)

    def _show(self, cloud: ViewedCloud) -> None:
        with self._lock:
            self._cloud, self._drawn = cloud, None
            self._scene.show(cloud)
            self._faces.content = corner_text(cloud.corner, cloud.unit)
            self._colouring.options = tuple(colouring.value for colouring in possible_colourings(cloud))
            self._percent.value = _first_percent(cloud)
            self._picked = Picked(cloud) if isinstance(cloud, CaptureCloud) else None
        self._pick_anew()
        self._redraw()

    def _pick_anew(self) -> None:
        with self._lock:
            if self._picked is None:
                self._measured.content = "In the cloud of one capture: choose it above."
                return
            self._picked = Picked(self._picked.cloud)
            self._show_picked(self._picked)

    def _pick(self, origin: Floats, direction: Floats) -> None:
        """A click: the point under it is measured from, or to."""
        with self._lock:
            if self._picked is None:
                return
            point = point_at(self._picked.cloud.points, origin, direction)
            if point is not None:
                self._picked = self._picked.with_point(point)
                self._show_picked(self._picked)

    def _show_picked(self, picked: Picked) -> None:
        self._measured.content = picked.told()
        self._scene.draw_picked(picked.places)

    def _redraw(self) -> None:
        """Draw the points as the controls are now; of many changes in a row, those that are outdated are skipped."""
        with self._lock:
            total = len(self._cloud.points)
            count = max(1, round(total * self._percent.value / _WHOLE_PERCENT))
            wanted = (self._cloud, count, Colouring(self._colouring.value))
            if wanted == self._drawn:
                return
            self._statement.content = "Drawing …"
            try:
                shown = self._scene.draw_points(count, wanted[2])
            except Exception as error:
                self._statement.content = f"**{escaped(failure_of(error).message)}**"
                return
            self._drawn = wanted
            self._statement.content = f"{statement(shown.points, total).capitalize()}. {escaped(shown.legend)}"


def _sending(path: Path) -> Callable[[viser.GuiEvent[Any]], None]:
    def send(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            event.client.send_file_download(f"{path.parent.name}-{path.name}", path.read_bytes(), save_immediately=True)

    return send


def _first_percent(cloud: ViewedCloud) -> int:
    return max(1, min(_WHOLE_PERCENT, round(_WHOLE_PERCENT * DEFAULT_SHOWN / len(cloud.points))))
