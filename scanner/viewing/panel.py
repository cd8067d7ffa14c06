"""The panel beside the 3-D view: the result's statements, and the controls of the view."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Lock

import viser

from calib.numerics import Floats
from scanner.results import NETWORK, Verdict, kind_of, verdict_of
from scanner.viewing.buttons import PLAIN
from scanner.viewing.clicking import Clicking, SetScale
from scanner.viewing.colouring import Colouring
from scanner.viewing.crop import Box, whole
from scanner.viewing.decimation import statement
from scanner.viewing.deviations import deviation_cloud, is_comparison
from scanner.viewing.files import add_files
from scanner.viewing.keeping import Keeping
from scanner.viewing.network import network_cloud
from scanner.viewing.result import ViewedCloud, ViewedResult
from scanner.viewing.scene import CloudScene
from scanner.viewing.stepping import keep_box, take_back
from scanner.viewing.texts import calibration_text, corner_text, escaped, notes_text, verdict_text
from scanner.viewing.view_controls import ViewControls, failures_shown

LinkTo = Callable[[Path], str]
Show = Callable[["ResultPanel"], None]


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
