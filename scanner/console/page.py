"""The operator's page: buttons and live image at the left, the result at the right, its cloud between them."""

from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

import viser

from hw.rig import Frame, Rig
from scanner.checking.report import CheckReport, CheckRow
from scanner.configuration import set_keys
from scanner.console.camera_view import CameraView
from scanner.console.results import earlier_results
from scanner.console.settings import Settings, plain_name
from scanner.console.texts import rows_text, status_text
from scanner.console.worker import Activity, Status, Worker
from scanner.results import REFUSAL_FILE
from scanner.ui import failure_of
from scanner.viewing.panel import ResultPanel
from scanner.viewing.result import ViewedResult
from scanner.viewing.server import add_readable_fonts
from scanner.viewing.texts import escaped

_LEFT_PX, _RIGHT_PX = 400, 380
_NONE_YET = "none yet"
_WATCHED_EVERY_S = 2.0


class ConsolePage:
    """`scanner.console.worker.Page` on viser; its buttons are requests to the worker that it starts."""

    def __init__(self, server: viser.ViserServer, settings: Settings) -> None:
        self._gui = gui = server.gui
        self._worker = Worker(settings, self)
        self._closed = Event()
        self._watcher = Thread(target=self._watch, name="earlier results", daemon=True)
        self._rows: list[CheckRow] = []
        self._maps: list[viser.GuiImageHandle] = []
        gui.main_panel.dock_left()
        gui.main_panel.set_width(_LEFT_PX)
        right = gui.add_panel()
        tab = right.add_tab("Result")
        right.dock_right()
        right.set_width(_RIGHT_PX)
        with tab:
            self._hint = gui.add_markdown("A scan's result appears here; earlier ones can be opened at the left.")
        self._result = ResultPanel(server, tab)
        add_readable_fonts(gui)
        self._add_buttons()
        with gui.add_folder("Camera"):
            self._camera = CameraView(gui, settings.load().required_rig, self._worker.change)
        self._check_folder = gui.add_folder("Check")
        with self._check_folder:
            self._found = gui.add_markdown("Not checked yet. A check takes seconds and says what to improve.")
            self._use = gui.add_button("Use this exposure", visible=False)
            self._save = gui.add_button("Write it into the configuration", visible=False)
            self._saved = gui.add_markdown("")
        self._use.on_click(lambda _: self._take_exposure())
        self._save.on_click(lambda _: self._save_exposure())
        self._exposure_us: float | None = None
        self._add_earlier()

    def start(self) -> None:
        """Open the rig and show what its camera sees."""
        self._worker.start()
        self._watcher.start()
        self._worker.request(Activity.LIVE)

    def close(self) -> Status:
        """End whatever runs, and give the rig back; returns how it ended."""
        self._closed.set()
        return self._worker.close()

    def on_status(self, status: Status) -> None:
        """Say it, and offer what can be done now."""
        busy = status.activity in (Activity.CHECKING, Activity.SCANNING)
        self._told.content = status_text(status)
        self._bar.visible = busy
        counted = status.stage is not None and status.stage.total > 0
        self._bar.value = status.stage.percent if status.stage and counted else 100.0
        self._bar.animated = not counted  # what cannot be counted moves without getting on
        for button in (self._check, self._scan, self._live):
            button.disabled = busy
        self._cancel.disabled = not busy or status.cancelling
        self._live.label = "Stop the live image" if status.activity is Activity.LIVE else "Live image"

    def on_camera(self, rig: Rig) -> None:
        """The live image begins."""
        self._camera.on_camera(rig)

    def on_frame(self, frame: Frame) -> None:
        """Show it."""
        self._camera.on_frame(frame)

    def on_row(self, row: CheckRow) -> None:
        """Show what is known so far."""
        self._rows.append(row)
        self._found.content = rows_text(self._rows)

    def on_report(self, report: CheckReport) -> None:
        """Show the check's maps, and offer its exposure."""
        with self._check_folder:
            self._maps += [self._gui.add_image(pixels, label=name) for name, pixels in report.pictures.items()]
        self._exposure_us = report.exposure_us
        if report.exposure_us is not None:
            self._use.label = f"Use the exposure that it proposes: {report.exposure_us / 1000:.4g} ms"
            self._use.visible = self._save.visible = True

    def on_result(self, folder: Path) -> None:
        """Open what a scan has left."""
        self._list_earlier()
        self._open(folder)

    def _add_buttons(self) -> None:
        gui = self._gui
        self._told = gui.add_markdown("Starting …")
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._name = gui.add_text("Name", "", hint="Of the next result, in scans/; left empty, the configuration's")
        self._name.on_update(lambda _: self._worker.change(name=plain_name(self._name.value)))
        self._scan = gui.add_button("Scan", hint="Capture, calibrate, reconstruct")
        self._check = gui.add_button("Check", hint="Look at devices, light and lenses first")
        self._live = gui.add_button("Live image", hint="Show what the camera sees")
        self._cancel = gui.add_button("Cancel", disabled=True, hint="Stop; what was captured is kept")
        self._scan.on_click(lambda _: self._worker.request(Activity.SCANNING))
        self._check.on_click(lambda _: self._begin_check())
        self._live.on_click(lambda _: self._toggle_live())
        self._cancel.on_click(lambda _: self._worker.cancel())

    def _add_earlier(self) -> None:
        with self._gui.add_folder("Earlier results"):
            self._earlier = self._gui.add_dropdown("Result", [_NONE_YET])
            button = self._gui.add_button("Open")
            self._opened = self._gui.add_markdown("")
        self._list_earlier()
        button.on_click(lambda _: self._open_earlier())

    def _list_earlier(self) -> None:
        names = tuple(str(path) for path in earlier_results()) or (_NONE_YET,)
        if names != self._earlier.options:
            self._earlier.options = names

    def _toggle_live(self) -> None:
        live = self._worker.status.activity is Activity.LIVE
        self._worker.request(Activity.NOTHING if live else Activity.LIVE)

    def _begin_check(self) -> None:
        if self._worker.request(Activity.CHECKING):
            self._rows = []
            for image in self._maps:
                image.remove()
            self._maps = []
            self._use.visible = self._save.visible = False
            self._saved.content = ""
            self._found.content = ""

    def _take_exposure(self) -> None:
        if self._exposure_us is not None:
            self._camera.set_exposure(self._exposure_us)

    def _save_exposure(self) -> None:
        if self._exposure_us is not None:
            path, values = self._worker.settings.config, {"rig.exposure_us": round(self._exposure_us, 1)}
            self._saved.content = _or_message(lambda: set_keys(path, values)) or f"Written into {escaped(str(path))}."

    def _watch(self) -> None:
        """Scans that are made elsewhere appear by themselves."""
        while not self._closed.wait(_WATCHED_EVERY_S):
            self._list_earlier()

    def _open_earlier(self) -> None:
        # The page says which; only what was offered to it is opened.
        offered = {str(path): path for path in earlier_results()}
        if (chosen := offered.get(self._earlier.value)) is not None:
            self._opened.content = _or_message(lambda: self._open(chosen))

    def _open(self, folder: Path) -> None:
        if (folder / REFUSAL_FILE).is_file():
            self._result.open_refused(folder)
        else:
            self._result.open(ViewedResult(folder))
        self._hint.visible = False


def _or_message(action: Callable[[], object]) -> str:
    """Do it; what to say if it fails, '' if not."""
    try:
        action()
    except Exception as error:
        return status_text(Status(message=failure_of(error).message))
    return ""
