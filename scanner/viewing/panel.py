"""The panel beside the 3-D view, and the page of `scan view` around it: the result's statements, the controls of the
view, the result's files to be opened and downloaded, and the steps that are taken from the page.
"""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import viser

from calib.numerics import Floats
from scanner.cleaning import read_cleaned
from scanner.comparing import CLOUD_FILE, COMPARE_PAGE, MESH_FILE, REFERENCE_CLOUD_FILE, REFERENCE_MESH_FILE
from scanner.configuration import CloudStep
from scanner.errors import InputError
from scanner.exporting import FORMATS, ExportRequest
from scanner.io import given_path, read_whole
from scanner.results import (
    CALIBRATION_FILE,
    KINDS,
    MERGED_FILE,
    NETWORK,
    NETWORK_FILE,
    REFUSAL_FILE,
    REPORT_FILE,
    Verdict,
    kind_of,
    read_steps,
    verdict_of,
    write_steps,
)
from scanner.ui import Terminal
from scanner.viewing.buttons import PLAIN
from scanner.viewing.clicking import Clicking, SetScale
from scanner.viewing.colouring import Colouring
from scanner.viewing.crop import Box, whole
from scanner.viewing.decimation import statement
from scanner.viewing.deviations import deviation_cloud, is_comparison
from scanner.viewing.keeping import Keeping
from scanner.viewing.result import ViewedCloud, ViewedResult, network_cloud
from scanner.viewing.scene import CloudScene
from scanner.viewing.server import add_style, announce_page, serving, wait
from scanner.viewing.texts import calibration_text, corner_text, escaped, link_html, notes_text, verdict_text
from scanner.viewing.view_controls import ViewControls, failures_shown

_SURFACES = tuple(name for kind in KINDS for name in (kind.cloud, kind.mesh) if name)
_COMPARED = (COMPARE_PAGE, CLOUD_FILE, MESH_FILE, REFERENCE_CLOUD_FILE, REFERENCE_MESH_FILE)
_FILES = (REPORT_FILE, CALIBRATION_FILE, MERGED_FILE, NETWORK_FILE, *_SURFACES, REFUSAL_FILE, *_COMPARED)
LinkTo = Callable[[Path], str]
Show = Callable[["ResultPanel"], None]


def add_files(gui: viser.GuiApi, folder: Path, link: Callable[[Path], str]) -> None:
    """Into the container that is open."""
    names = [name for name in _FILES if (folder / name).is_file()]
    if REPORT_FILE in names:
        gui.add_html(link_html(link(folder / REPORT_FILE), "Open the report"))
    with gui.add_folder("Files", expand_by_default=False):
        message = gui.add_markdown("")
        for name in names:
            button = gui.add_button(f"Download {name}", color=PLAIN)
            button.on_click(_sending(f"{folder.name}-{name}", folder / name, message))
        if (folder / CALIBRATION_FILE).is_file():
            _add_exports(gui, folder)


def _add_exports(gui: viser.GuiApi, folder: Path) -> None:
    """Formats of one file each; the others are folders, which the command makes."""
    formats = {name: export for name, export in FORMATS.items() if export.suffixes}
    chosen = gui.add_dropdown("Export as", [f"{name}: {export.about}" for name, export in formats.items()])
    button = gui.add_button("Export", color=PLAIN)
    message = gui.add_markdown("")

    def export(event: viser.GuiEvent[Any]) -> None:
        form = formats[chosen.value.partition(":")[0]]
        message.content = "Exporting …"
        with failures_shown(message), tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch, f"{folder.name}{form.ending}")
            sentences = form.write(ExportRequest(folder, out))
            if event.client is not None:
                event.client.send_file_download(out.name, out.read_bytes(), save_immediately=True)
            message.content = f"{out.name}: {'; '.join(sentences)}"

    button.on_click(export)


def _sending(name: str, path: Path, message: viser.GuiMarkdownHandle) -> Callable[[viser.GuiEvent[Any]], None]:
    def send(event: viser.GuiEvent[Any]) -> None:
        if event.client is None:
            return
        message.content = ""
        with failures_shown(message):
            event.client.send_file_download(name, read_whole(path), save_immediately=True)

    return send


def keep_box(result: ViewedResult, name: str, cloud: ViewedCloud, box: Box) -> None:
    """Write a box around a part of the cloud called `name` as the result's last step. Raises InputError, StorageError
    if it has no wall, or cannot be written.
    """
    if not box.bounded:
        raise InputError("the box holds everything: move an end of a range first")
    cleaned = read_cleaned(result.folder, result.number_of(name))
    frame = box.frame
    along = frame.along(cloud.points)
    reach = np.ptp(along, axis=0)
    low = np.where(np.isfinite(box.low), box.low, along.min(axis=0) - reach)
    high = np.where(np.isfinite(box.high), box.high, along.max(axis=0) + reach)
    # The steps' axes may be others than the cloud's.
    corners = cleaned.clouds()[-1].frame @ (frame.origin + np.stack([0 * frame.origin, frame.axes[0], frame.axes[1]]))
    steps = [*cleaned.steps, CloudStep(box=_text(np.concatenate([low, high, corners.ravel()])))]
    read_cleaned(result.folder, steps=steps).clouds()
    write_steps(result.folder, steps)


def take_back(result: ViewedResult) -> None:
    """Take the result's last step back. Raises InputError, StorageError."""
    write_steps(result.folder, read_steps(result.folder)[:-1])


def _text(lengths: Floats) -> str:
    return ",".join("0" if abs(length) < 1e-6 else f"{length:.9g}" for length in lengths)


class ResultPanel:
    """Shows one result at a time, in the scene and as controls and text where `place` is.

    `link` gives the address of a file of a result on this server; `set_scale` is as of `Clicking`.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        scene: CloudScene,
        place: viser.GuiTabHandle | viser.GuiFolderHandle,
        link: LinkTo,
        set_scale: SetScale | None = None,
    ) -> None:
        self._gui, self._scene = gui, scene
        self._place, self._link, self._set_scale = place, link, set_scale
        self._lock = Lock()
        self._parts: list[viser.GuiFolderHandle] = []
        self._clicking: Clicking | None = None
        self._scene.on_click(self._pick)

    def close(self) -> None:
        """Show no result."""
        with self._lock:
            self._remove()
            self._scene.clear()

    def open(self, result: ViewedResult, name: str = "") -> None:
        """Show a result, or that cloud of it which is called `name`, in place of the last one.

        Raises InputError if a file is missing or damaged.
        """
        name = name or result.names[0]
        cloud = result.cloud(name)  # before anything is removed, so that a damaged result replaces nothing
        with self._lock, self._place:
            self._remove()
            title = result.folder.name or str(result.folder)
            with self._folder(f"Result: {title}"):
                self._gui.add_markdown(verdict_text(result.verdict))
                add_files(self._gui, result.folder, self._link)
            with self._folder("View"):
                self._add_choice(result, name)
                self._scene.show(cloud)
                controls = ViewControls(self._gui, self._scene, cloud, title, partial(self._keep, result, name, cloud))
                self._add_steps(result, name)
                Keeping(self._gui, self._scene, title, lambda: controls.legend)
            with self._folder("Measure by clicking"):
                self._clicking = Clicking(self._gui, self._scene, cloud, self._set_scale)
            with self._folder("Calibration, ± one standard deviation"):
                self._gui.add_markdown(calibration_text(result.calibration, result.truth))
            with self._folder("Faces"):
                self._gui.add_markdown(corner_text(cloud.corner, cloud.unit))
            self._add_notes(result.verdict)
        controls.draw()

    def open_unsaved(self, some: ViewedCloud, count: int) -> None:
        """Show some points of a result that is being saved, in place of the last result."""
        with self._lock, self._place:
            self._remove()
            with self._folder("Result: not saved yet"):
                message = f"Faces are being measured, files and report written; {statement(len(some.points), count)}."
                self._gui.add_markdown(message)
            self._scene.show(some)
            self._scene.draw_points(1.0, Colouring.CAMERA, whole(some))

    def open_verdict(self, folder: Path, cloud: ViewedCloud | None = None, verdict: Verdict | None = None) -> None:
        """Show why a capture was refused, or a network or a comparison with its cloud, in place of the last result.

        `verdict`: by default that of the folder's files. Raises InputError.
        """
        verdict = verdict or verdict_of(folder)
        with self._lock, self._place:
            self._remove()
            self._scene.clear()
            with self._folder(f"Result: {folder.name}"):
                self._gui.add_markdown(verdict_text(verdict))
                add_files(self._gui, folder, self._link)
            if cloud is not None:
                self._scene.show(cloud)
                with self._folder("View"):
                    controls = ViewControls(self._gui, self._scene, cloud, folder.name)
                    Keeping(self._gui, self._scene, folder.name, lambda: controls.legend)
                if cloud.scans is not None:
                    with self._folder("Measure by clicking"):
                        self._clicking = Clicking(self._gui, self._scene, cloud, None)
            self._add_notes(verdict)
        if cloud is not None:
            controls.draw()

    def _add_notes(self, verdict: Verdict | None) -> None:
        if text := notes_text(verdict):
            with self._folder("What else the report says"):
                self._gui.add_markdown(text)

    def _remove(self) -> None:
        for part in self._parts:
            part.remove()
        self._parts = []
        self._clicking = None

    def _folder(self, label: str) -> viser.GuiFolderHandle:
        self._parts.append(self._gui.add_folder(label))
        return self._parts[-1]

    def _add_choice(self, result: ViewedResult, name: str) -> None:
        if len(result.names) < 2:
            return
        choice = self._gui.add_dropdown("Cloud", result.names, initial_value=name)
        message = self._gui.add_markdown("", visible=False)
        choice.on_update(lambda _: self._open_another(partial(self.open, result, choice.value), message))

    def _keep(self, result: ViewedResult, name: str, cloud: ViewedCloud, box: Box) -> None:
        keep_box(result, name, cloud, box)
        self.open(ViewedResult(result.folder), name)

    def _add_steps(self, result: ViewedResult, name: str) -> None:
        """What was done to the cloud, and a button that takes the last of it back."""
        if not result.steps:
            return
        self._gui.add_markdown(f"Steps: {escaped('; '.join(step.name for step in result.steps))}.")
        message = self._gui.add_markdown("", visible=False)

        def undo() -> None:
            take_back(result)
            self.open(ViewedResult(result.folder), name)

        button = self._gui.add_button("Take the last step back", color=PLAIN)
        button.on_click(lambda _: self._open_another(undo, message))

    def _open_another(self, opening: Callable[[], None], message: viser.GuiMarkdownHandle) -> None:
        message.content, message.visible = "Reading …", True
        with failures_shown(message):
            opening()

    def _pick(self, origin: Floats, direction: Floats) -> None:
        clicking = self._clicking
        if clicking is not None:
            clicking.pick(origin, direction)


def reading(folder: Path) -> Show:
    """Read a result; returns what shows it on a panel. Raises InputError if it is none, or refused, or damaged."""
    if kind_of(folder) is NETWORK:
        cloud = network_cloud(folder)
        return lambda panel: panel.open_verdict(folder, cloud)
    if is_comparison(folder):
        compared, verdict = deviation_cloud(folder)
        return lambda panel: panel.open_verdict(folder, compared, verdict)
    result = ViewedResult(folder)
    result.cloud(result.names[0])
    return lambda panel: panel.open(result)


def view_result(folder: Path, host: str, port: int | None, terminal: Terminal, *, browser: bool) -> None:
    """Serve a result until Ctrl-C, which raises KeyboardInterrupt. Raises InputError."""
    with terminal.step("Reading the result"):
        show = reading(folder)
    with serving(f"Result {given_path(folder).name}", host, port) as served:
        gui = served.server.gui
        gui.main_panel.dock_right()
        tabs = gui.add_tab_group()
        with tabs.add_tab("Result") as tab:
            add_style(gui)
        show(ResultPanel(gui, CloudScene(served.server), tab, served.served_files.link))
        announce_page(served.address, host, terminal, browser=browser)
        wait()
