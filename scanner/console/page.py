"""The operator's page: what is done now at the top, below it one of three pages, and beside them the cloud."""

import logging
from pathlib import Path
from threading import Event, Thread

import viser

from hw.rig import Frame
from scanner.configuration import set_keys
from scanner.console.calibration_view import CalibrationView
from scanner.console.camera_view import CameraView
from scanner.console.check_view import CheckView
from scanner.console.configuration_view import ConfigurationView
from scanner.console.history import History
from scanner.console.live_view import LiveView
from scanner.console.network_view import NetworkView
from scanner.console.operating import Operating
from scanner.console.picture import LargeImage
from scanner.console.settings import ConsoleSettings
from scanner.console.worker import Activity, Status, Worker
from scanner.interruption import finishing
from scanner.results import REFUSAL_FILE, Scan
from scanner.ui import Terminal
from scanner.viewing import (
    CloudScene,
    HintedButton,
    KnownScale,
    ResultPanel,
    Serving,
    add_style,
    announce_page,
    preview_scan,
    reading,
    serving,
    wait,
)

_WIDTH_PX = 380
_LOOKED_EVERY_S = 1.0
_PAGES = CAPTURE, RESULT, HISTORY = ("Capture", "Result", "History")
_WHY_CLOSE, _NOTHING_OPEN = "The camera's image takes its place", "No result is open."
_KEYS = ("I", "R", "H")  # with Shift; digits with it are other characters on every keyboard


class ConsolePage:
    """`scanner.console.worker.Page` on viser; its buttons are requests to the worker that it starts."""

    def __init__(self, served: Serving, settings: ConsoleSettings) -> None:
        gui, scene = served.server.gui, CloudScene(served.server)
        self._worker = Worker(settings, self)
        self._closed = Event()
        self._opened: Path | None = None
        self._watcher = Thread(target=self._watch, name="clock and history", daemon=True)
        gui.main_panel.dock_left()
        gui.main_panel.set_width(_WIDTH_PX)
        add_style(gui, panel_left=True)
        self._operating = Operating(gui, self._worker, self._begin_check)
        choice = gui.add_button_group("Page", _PAGES)
        choice.on_click(lambda _: self._turn_to(choice.value))
        self._pages = {name: gui.add_folder(None, visible=name == CAPTURE) for name in _PAGES}
        with self._pages[CAPTURE]:
            # Above the camera, so that it is in view when it ends.
            self._live = LiveView(gui, scene, self.on_frame)
            self._check = CheckView(gui, settings.config, lambda exposure_us: self._camera.set_exposure(exposure_us))
            self._network = NetworkView(gui, self._worker.change, self._operating.prefer_network)
            with gui.add_folder("Camera"):
                large = LargeImage(served.server.scene, scene.windows)
                rig = settings.in_turn()[0].load().required_rig
                self._camera: CameraView = CameraView(gui, large, rig, self._worker.change)
            with gui.add_folder("Configuration", expand_by_default=False):
                self._configuration = ConfigurationView(gui, settings.config)
        with self._pages[RESULT]:
            self._hint = gui.add_markdown("A scan's result appears here; earlier ones can be opened in the history.")
            self._put_away = HintedButton(gui, "Close the result", lambda _: self._close_result(), _WHY_CLOSE)
            self._put_away.allow(_NOTHING_OPEN)
        self._result = ResultPanel(gui, scene, self._pages[RESULT], served.served_files.link, self._set_scale)
        with self._pages[HISTORY]:
            self._calibration = CalibrationView(gui, lambda: self._worker.settings.calibration)
            self._history = History(gui, self._open, served.served_files.link, self._moved)
        # What the worker tells concerns one part each.
        self.on_camera, self.on_sight = self._camera.on_camera, self._network.on_sight
        self.on_captured = self._operating.sound
        self.on_row, self.on_report = self._check.add, self._check.end
        for name, key in zip(_PAGES, _KEYS, strict=True):
            self._add_key(gui, name, key)
        self._network.follow(settings)

    def start(self) -> None:
        """Open the rig and show what its camera sees."""
        self._worker.start()
        self._watcher.start()
        self._worker.request(Activity.LIVE)

    def close(self) -> Status:
        """End whatever runs, and give the rig back; returns how it ended."""
        self._closed.set()
        self._history.close()
        return self._worker.close()

    def on_status(self, status: Status) -> None:
        """Say it, and offer what can be done now."""
        self._operating.show(status)
        self._network.show(status)

    def on_frame(self, frame: Frame, camera: str = "") -> None:
        """Show it."""
        self._camera.on_frame(frame, camera)
        if camera:
            self._network.on_frame(camera, frame)

    def on_cloud(self, scan: Scan) -> None:
        """Show some of its points, until its result can be opened."""
        self._result.open_unsaved(*preview_scan(scan))
        self._turn_to_result()

    def on_result(self, folder: Path) -> None:
        """Open what a scan has left."""
        self._history.refresh()
        self._open(folder)

    def live_watcher(self) -> LiveView:
        """The page's."""
        self._turn_to(CAPTURE)
        return self._live

    def _begin_check(self) -> None:
        if self._worker.request(Activity.CHECKING):
            self._turn_to(CAPTURE)
            self._check.begin(self._worker.settings.rig_key)

    def _turn_to(self, page: str) -> None:
        for name, folder in self._pages.items():
            folder.visible = name == page

    def _add_key(self, gui: viser.GuiApi, page: str, key: str) -> None:
        command = gui.add_command(f"{page} page", hotkey=key, modifier="shift")
        command.on_trigger(lambda _: self._turn_to(page))

    def _set_scale(self, scale: KnownScale) -> str:
        path = self._worker.settings.config
        set_keys(path, scale.keys)
        return f"Written into {path}: {scale.line}"

    def _watch(self) -> None:
        """Time goes by, and scans that are made elsewhere appear by themselves."""
        while not self._closed.wait(_LOOKED_EVERY_S):
            self._operating.tick(self._worker.status)
            self._network.tick()
            self._network.follow(self._worker.settings)
            self._history.refresh()
            self._calibration.follow()
            self._configuration.follow()

    def _open(self, folder: Path) -> None:
        if (folder / REFUSAL_FILE).is_file():
            self._result.open_verdict(folder)
        else:
            reading(folder)(self._result)
        self._opened = folder
        self._turn_to_result()

    def _moved(self, result: Path, place: Path | None) -> None:
        """A result has another name, or is in the bin: what is shown of it is read from where it is."""
        if result != self._opened:
            return
        self._opened = place
        if place is None:
            self._close_result()
        elif (place / REFUSAL_FILE).is_file():
            self._result.open_verdict(place)
        else:
            reading(place)(self._result)

    def _close_result(self) -> None:
        self._opened = None
        self._result.close()
        self._hint.visible = True
        self._put_away.allow(_NOTHING_OPEN)

    def _turn_to_result(self) -> None:
        self._hint.visible = False
        self._put_away.allow()
        self._turn_to(RESULT)


log = logging.getLogger(__name__)


def console(settings: ConsoleSettings, host: str, port: int | None, terminal: Terminal, *, browser: bool) -> None:
    """Serve the page until Ctrl-C, which raises KeyboardInterrupt. Raises InputError.

    A scan that is running then is cancelled: what it has captured is kept, and the terminal says where.
    """
    config = settings.in_turn()[0].load()
    required = (config.required_rig, config.camera_size, config.projector_size)  # said in the terminal if missing
    log.info("console for %s", required)
    with serving(f"Console: {settings.config.stem}", host, port) as served:
        page = ConsolePage(served, settings)
        try:
            page.start()
            announce_page(served.address, host, terminal, browser=browser)
            wait()
        finally:
            with finishing(ending=True):
                ended = page.close()
                if ended.message:
                    terminal.show(ended.message)
