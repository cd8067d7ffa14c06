"""The thread that owns the rig, and does one thing at a time: live image, check, or scan.

The operator at the page: learns what captures add, and is asked to move the rig between them.
"""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import count
from math import inf
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import Any, Protocol

from hw.errors import FrameLostError
from hw.rig import Frame, Rig, settable_exposure
from scanner.checking import CheckReport, CheckRow, check_configured_rig, opened
from scanner.console.progress import CancelledError, ProgressStep, StagedProgress, durations_in
from scanner.console.results import SCANS, newest_calibration, newest_result
from scanner.console.settings import ConsoleSettings, drawn
from scanner.errors import InputError
from scanner.jobs import scan
from scanner.live import Watcher, Wishes, result_texts, scan_live
from scanner.networks import KnownDistance, Pair, PairProgress, scan_network
from scanner.results import LOG_FILE, Scan
from scanner.ui import failure_of

_LOOKED_EVERY_S = 0.2
log = logging.getLogger(__name__)

_FRAME_S = 0.2  # no more live frames than this: a page and a network have to keep up
_TURN_S = 2.0  # of one camera after another
_LEAVING_S = 30.0


class PageOperator:
    """A `scanner.ui.Operator`. `on_asked` receives the message and the question ('' for none)."""

    can_ask = True

    def __init__(self, cancelled: Event, on_asked: Callable[[tuple[str, ...], str], None]) -> None:
        self._cancelled, self._on_asked = cancelled, on_asked
        self._sentences: tuple[str, ...] = ()
        self._answers: SimpleQueue[bool] = SimpleQueue()

    def tell(self, *sentences: str) -> None:
        """Show a message until the next one."""
        self._sentences = sentences
        self._on_asked(sentences, "")

    def note(self, text: str) -> None:
        """Show it as well."""
        self.tell(*self._sentences, text)

    def ready(self, what: str) -> bool:
        """Wait for one of two buttons. Raises CancelledError."""
        while not self._answers.empty():
            self._answers.get()  # of buttons that were pressed twice
        self._on_asked(self._sentences, what)
        while not self._cancelled.is_set():
            try:
                more = self._answers.get(timeout=_LOOKED_EVERY_S)
            except Empty:
                continue
            self.tell()
            return more
        raise CancelledError("cancelled")

    def answer(self, *, more: bool) -> None:
        """A button was pressed."""
        self._answers.put(more)


class Activity(StrEnum):
    """The worker's current activity."""

    NOTHING = "Ready"
    LIVE = "Live image"
    CLOUDS = "Live clouds"
    CHECKING = "Checking"
    SCANNING = "Scanning"
    NETWORK = "Network"


@dataclass(frozen=True)
class Status:
    """The worker's status. `message`: why the last activity failed, as the terminal would show it; '' if it succeeded.

    `guidance` and `question` are addressed to the operator; `question` is '' if nothing is asked.
    """

    activity: Activity = Activity.NOTHING
    stage: ProgressStep | None = None
    message: str = ""
    cancelling: bool = False
    guidance: tuple[str, ...] = ()
    question: str = ""

    @property
    def busy(self) -> bool:
        """Whether something is running that ends by itself or by being cancelled."""
        return self.activity not in (Activity.NOTHING, Activity.LIVE)


class Page(Protocol):
    """The observer of the worker. Its methods are called from the worker's thread."""

    def on_status(self, status: Status) -> None:
        """The worker's status has changed."""

    def on_camera(self, rig: Rig) -> None:
        """The rig is open."""

    def on_frame(self, frame: Frame, camera: str = "") -> None:
        """The camera has taken a frame; of a network it has a name."""

    def on_sight(self, sight: PairProgress, frame: Frame | None) -> None:
        """A camera of a network has taken a frame in a projector's light, or it is known what it sees there."""

    def on_captured(self) -> None:
        """Called when all frames of a capture are taken."""

    def on_row(self, row: CheckRow) -> None:
        """The check has found something."""

    def on_report(self, report: CheckReport) -> None:
        """The check is over."""

    def on_cloud(self, scan: Scan) -> None:
        """A scan has its clouds, which are being saved; called from a thread of its own."""

    def on_result(self, folder: Path) -> None:
        """A scan has left a result."""

    def live_watcher(self) -> Watcher:
        """Who looks at live clouds."""


class Worker:
    """The rig's owner, from `start` to `close`. Requests are refused (False) while a check or a scan is running.

    `status` and `settings` are the current ones.
    """

    def __init__(self, settings: ConsoleSettings, page: Page) -> None:
        self.settings = settings
        self._page = page
        self._lock = Lock()
        self.status = Status()
        self._next: SimpleQueue[Activity | None] = SimpleQueue()
        self._cancelled = Event()
        self._leave_live = Event()
        self._wishes = Wishes()
        self._operator = PageOperator(self._cancelled, self._on_asked)
        self._durations_s = dict(durations_in(newest / LOG_FILE)) if (newest := newest_result()) else {}
        self._thread = Thread(target=self._run, name="rig", daemon=True)

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def change(self, **changes: Any) -> None:
        """Change fields of the settings; a live image follows at once, a running scan keeps what it began with."""
        with self._lock:
            self.settings = replace(self.settings, **changes)

    def request(self, activity: Activity) -> bool:
        """Do something else than now; `Activity.NOTHING` ends the live image."""
        with self._lock:
            if self.status.busy or not self._next.empty():
                return False
            self._cancelled.clear()
            self._leave_live.set()
            self._next.put(activity)
        return True

    def cancel(self) -> None:
        """End a check or a scan at the next frame or step."""
        with self._lock:
            if self.status.busy:
                (self._wishes.end if self.status.activity is Activity.CLOUDS else self._cancelled).set()
                self._tell(replace(self.status, cancelling=True))

    def answer(self, *, more: bool) -> None:
        """Answer the question in the status: take another capture, or continue with those there are."""
        self._operator.answer(more=more)

    def close(self) -> Status:
        """Cancel whatever runs, and end; returns how it ended."""
        self._cancelled.set()
        self._wishes.end.set()
        self._next.put(None)
        self._leave_live.set()
        if self._thread.is_alive():
            self._thread.join(_LEAVING_S)
        return self.status

    def _run(self) -> None:
        while (activity := self._next.get()) is not None:
            self._leave_live.clear()
            if not self._next.empty():
                continue  # only a request to end comes after another
            with self._lock:
                self._tell(Status(activity))
            message = ""
            try:
                self._do(activity)
            except CancelledError as error:
                message = "\n".join(["Cancelled.", *getattr(error, "__notes__", [])])
            except Exception as error:
                message = failure_of(error).message
            with self._lock:
                self._tell(Status(message=message))

    def _do(self, activity: Activity) -> None:
        progress = StagedProgress(
            self._cancelled, self._on_stage, self._page.on_frame, self._page.on_captured, self._durations_s
        )
        match activity:
            case Activity.LIVE:
                for turn in count():
                    if self._leave_live.is_set():
                        return
                    cameras = self.settings.in_turn()
                    self._live(cameras[turn % len(cameras)], for_s=_TURN_S if len(cameras) > 1 else inf)
            case Activity.CLOUDS:
                self._clouds(progress)
            case Activity.CHECKING:
                self._page.on_report(check_configured_rig(self.settings.load(), progress, self._page.on_row))
            case Activity.SCANNING:
                captures = self.settings.captures
                with self._leaving_result() as out:
                    scan(
                        self.settings.load(),
                        out,
                        captures=captures,
                        operator=self._operator,
                        progress=progress,
                        on_cloud=self._on_cloud,
                    )
            case Activity.NETWORK:
                settings = self.settings
                with self._leaving_result() as out:
                    known = KnownDistance.parse(settings.distance) if settings.distance else None
                    scan_network(
                        settings.load_whole(), out, known=known, progress=progress, on_sight=self._page.on_sight
                    )

    @contextmanager
    def _leaving_result(self) -> Iterator[Path]:
        """Where the block is to make the next result, which is shown: a refused capture is one, too."""
        out = self.settings.destination()
        try:
            yield out
        finally:
            if out.is_dir():
                self._page.on_result(out)

    def _live(self, settings: ConsoleSettings, for_s: float) -> None:
        """Show what the camera sees, for a while, until something else is wanted, or a setting that an open rig cannot
        change.
        """
        config, chosen = settings.load(), self.settings.pair
        camera = settings.pair[0] if settings.pair else ""
        title = f"What {camera or 'the camera'} sees"
        self._on_stage(ProgressStep("Preparing the rig"))
        with _naming(settings.pair), opened(config) as rig:
            self._page.on_camera(rig)
            self._on_stage(ProgressStep(title))
            patterns = config.sequence.patterns(rig.projector.size)
            picture, lost, end_s = None, 0, time.monotonic() + for_s
            while not self._leave_live.is_set():
                began_s, wanted = time.monotonic(), self.settings
                if began_s > end_s or wanted.pair != chosen:
                    return
                if wanted.gain != settings.gain or not _expose(rig, settings, wanted):
                    return
                try:
                    if wanted.picture != picture:
                        (frame,) = rig.photograph([drawn(wanted.picture, patterns, rig.projector.size)])
                    else:
                        frame = rig.camera.grab()
                except FrameLostError as error:
                    lost += 1
                    self._on_stage(ProgressStep(f"{title} ({lost} frames were lost; the last: {error})"))
                else:
                    settings, picture = wanted, wanted.picture
                    self._page.on_frame(frame, camera)
                self._leave_live.wait(max(0.0, began_s + _FRAME_S - time.monotonic()))

    def _clouds(self, progress: StagedProgress) -> None:
        """Show live clouds until that is cancelled; kept ones become a result."""
        settings, watcher = self.settings, self._page.live_watcher()
        calibration = settings.calibration or newest_calibration()
        if calibration is None:
            raise InputError(
                f"live clouds need a calibrated rig, and {SCANS} has no calibration: scan a corner first, or start "
                "scan console with --calibration FILE"
            )
        out, self._wishes = settings.destination("-live"), Wishes()
        self._on_stage(ProgressStep("Looking"))
        try:
            result = scan_live(
                settings.load(), out, calibration=calibration, wishes=self._wishes, progress=progress, watcher=watcher
            )
        except KeyboardInterrupt:  # nothing was kept
            return
        for sentence in result_texts(len(result.kept), out, settings.config, calibration):
            watcher.tell(sentence)
        if result.ended_by is not None:
            raise result.ended_by

    def _on_cloud(self, scan: Scan) -> None:
        try:
            self._page.on_cloud(scan)
        except Exception:  # nothing that a page cannot show is worth losing a scan
            log.exception("the cloud could not be shown before its result")

    def _on_stage(self, stage: ProgressStep) -> None:
        with self._lock:
            self._tell(replace(self.status, stage=stage))

    def _on_asked(self, guidance: tuple[str, ...], question: str) -> None:
        with self._lock:
            self._tell(replace(self.status, guidance=guidance, question=question))

    def _tell(self, status: Status) -> None:
        self.status = status
        self._page.on_status(status)


@contextmanager
def _naming(pair: Pair | None) -> Iterator[None]:
    """An error of the block says with which devices of a network it came."""
    try:
        yield
    except Exception as error:
        if pair is not None:
            error.add_note(f"This was {pair[0]} with {pair[1]}.")
        raise


def _expose(rig: Rig, now: ConsoleSettings, wanted: ConsoleSettings) -> bool:
    """Change the exposure if that is wanted; False if this camera has to be opened anew for it. Raises DeviceError."""
    if wanted.exposure_us == now.exposure_us:
        return True
    camera = settable_exposure(rig.camera)
    if wanted.exposure_us is None or camera is None:
        return False
    camera.expose_for(wanted.exposure_us)
    return True
