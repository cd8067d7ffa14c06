"""The job: look at a rig, show its clouds, and keep those that are wanted."""

import shutil
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event

from calib.diagnostics import Uncertainty
from calib.finding import FindingKind
from calib.geometry import Calibration
from calib.refusal import RefusalError
from hw.ahead import in_background
from hw.backends import RigSettings
from hw.errors import DeviceError
from hw.open_rig import at_place, at_place_or_last, moves_by_itself, turns_by_itself
from hw.rig import Rig
from scanner.checking import opened
from scanner.configuration import Config
from scanner.errors import InputError, is_of_memory, is_of_threads
from scanner.live.cloud import LiveCloud, LiveDecoder
from scanner.live.first_look import FirstLook, look
from scanner.live.given_calibration import find_change_live
from scanner.live.joining import joining, keep_station
from scanner.live.rounds import best_sequence, take_rounds
from scanner.live.sequence import LiveSequence
from scanner.live.watching import Account, cloud_text, watch
from scanner.reconstruction import scaled
from scanner.results import CAPTURES_FOLDER, Decoded, new_result
from scanner.stations import given_rig
from scanner.ui import SILENT, Progress, Terminal

# Rounds without a usable cloud after which an unattended run gives up.
_PATIENCE = 100

NO_CLOUD = FindingKind(
    "no-cloud",
    "The last rounds of live clouds gave none.",
    "Check exposure, light and synchronisation with scan check, and hold the rig still.",
)


class Watcher:
    """An observer, which may make requests. It is called from several threads; this one does nothing."""

    def begin(self, calibration: Calibration, wishes: "Wishes") -> None:
        """Clouds of a calibrated rig are about to come; the wishes may be added to until they end."""

    def on_rig(self, rig: Rig) -> None:
        """The rig is open."""

    def on_round(self, cloud: LiveCloud | None, account: Account) -> None:
        """There is a new cloud; or none, for the frames of this round contradict each other."""

    def tell(self, sentence: str) -> None:
        """Receive a sentence."""


@dataclass
class Wishes:
    """`number`: of clouds to keep, then it ends; `every_s`: keep one so often; `of_room`: kept clouds are of a room in
    which the rig is moved, else of a thing before it; `now`: keep the next one; `end`.
    """

    number: int | None = None
    every_s: float | None = None
    of_room: bool = False
    now: Event = field(default_factory=Event)
    end: Event = field(default_factory=Event)

    def due(self, kept: int, last_s: float) -> bool:
        """Whether to keep the cloud that has just come; the one before was kept at `last_s`, by `time.monotonic`."""
        if self.number is not None and kept >= self.number:
            return False
        if self.every_s is not None:
            return time.monotonic() - last_s >= self.every_s or self.now.is_set()
        return self.number is not None or self.now.is_set()


@dataclass
class LiveResult:
    """The kept stations. `ended_by`: the error that ended the job early, None if there was none."""

    calibration: Calibration
    account: Account = field(default_factory=Account)
    kept: list[Decoded] = field(default_factory=list)
    ended_by: BaseException | None = None


def scan_live(
    config: Config,
    out: Path,
    *,
    calibration: Path,
    wishes: Wishes,
    depths: tuple[float, float] | None = None,
    overwrite: bool = False,
    terminal: Terminal = SILENT,
    progress: Progress | None = None,
    watcher: Watcher,
) -> LiveResult:
    """Scan until `wishes` or Ctrl-C end it. What was kept becomes `out`, also after a device failure or without memory
    for more; without any, there is no folder.

    `depths`: range of the scene, in the calibration's unit. `progress` receives the progress instead of the `terminal`.

    Raises InputError, DeviceError, RefusalError; KeyboardInterrupt, also if `wishes` end it with nothing kept.
    """
    start = given_rig(calibration, config)
    known = scaled(start.given or start.calibration, None, config.scale)
    if wishes.number is not None and wishes.number < 1:
        raise InputError(f"--clouds: expected 1 or more, found {wishes.number}")
    _refuse_missing_places(config.required_rig, wishes)
    result = LiveResult(known)
    watcher.begin(known, wishes)
    with new_result(out, config, overwrite=overwrite, keep_capture=True, tell=terminal.note) as folder:
        try:
            _look_on(config, folder, result, start.uncertainty, wishes, depths, progress or terminal, watcher)
            if not result.kept:
                raise KeyboardInterrupt
        except (KeyboardInterrupt, Exception) as error:
            expected = isinstance(error, KeyboardInterrupt | DeviceError | RefusalError)
            if not result.kept or not (expected or is_of_memory(error) or is_of_threads(error)):
                raise
            result.ended_by = error
            # There may not have been enough memory to keep one more.
            shutil.rmtree(_place(folder, result), ignore_errors=True)
    if result.ended_by is not None:
        result.ended_by.add_note(f"What was kept is in {out}.")
    return result


def _is_automatic(settings: RigSettings, wishes: Wishes) -> bool:
    """Whether the simulation moves its thing, or its rig, after each kept cloud."""
    return moves_by_itself(settings) if wishes.of_room else turns_by_itself(settings)


def _refuse_missing_places(settings: RigSettings, wishes: Wishes) -> None:
    if not _is_automatic(settings, wishes):
        return
    try:
        at_place(settings, (wishes.number or 1) - 1)
    except DeviceError as error:
        raise InputError(f"--clouds {wishes.number}: {error}") from error


def _look_on(
    config: Config,
    folder: Path,
    result: LiveResult,
    stated: Uncertainty | None,
    wishes: Wishes,
    depths: tuple[float, float] | None,
    progress: Progress,
    watcher: Watcher,
) -> None:
    first: tuple[FirstLook, LiveSequence] | None = None
    by_itself = _is_automatic(config.required_rig, wishes)
    joined = joining(result.calibration, watcher.tell, of_room=wishes.of_room)
    with joined as join, in_background(_keeping(folder, result, join, watcher)) as begin:
        keeper = Keeper(wishes, begin)
        while not keeper.has_ended:
            begun = keeper.begun
            with ExitStack() as devices:
                with progress.step("Preparing the rig"):
                    rig = devices.enter_context(opened(_moved(config, begun if by_itself else 0)))
                if first is None:
                    with progress.step("Looking at light and dark"):
                        first_look = look(rig, config)
                        first = first_look, best_sequence(rig, first_look, result.calibration, depths)
                        for finding in find_change_live(rig, first[1], first_look, result.calibration, stated):
                            watcher.tell(str(finding))
                watcher.on_rig(rig)
                _watch(rig, *first, result, keeper, watcher, one_only=by_itself)


@dataclass
class Keeper:
    """Keeps clouds through `begin` when they are due.

    `begun`: their number. `useless`: rounds since the last kept one.
    """

    wishes: Wishes
    begin: Callable[[LiveCloud, LiveSequence, Rig, str], None]
    begun: int = 0
    useless: int = 0
    _last_s: float = field(default_factory=time.monotonic)

    @property
    def has_ended(self) -> bool:
        """Whether the scan should end."""
        return self.wishes.end.is_set() or self.begun == self.wishes.number

    def offer(self, cloud: LiveCloud | None, sequence: LiveSequence, rig: Rig) -> None:
        """Process a new round. Raises RefusalError if a number of clouds is wanted and none can be had."""
        if not self.wishes.due(self.begun, self._last_s):
            return
        if cloud is None or not len(cloud.points):
            self.useless += 1
            if self.wishes.number is not None and self.useless == _PATIENCE:
                raise RefusalError(
                    NO_CLOUD,
                    f"The last {_PATIENCE} rounds gave no cloud: "
                    + ("the fringes are not visible." if cloud else "their frames contradict each other."),
                    NO_CLOUD.remedy,
                )
        else:
            self.wishes.now.clear()
            self.useless = 0
            self._last_s = time.monotonic()
            self.begun += 1
            self.begin(cloud, sequence, rig, f"Station {self.begun}")


def _keeping(
    folder: Path, result: LiveResult, join: Callable[[Sequence[Decoded]], None], watcher: Watcher
) -> Callable[[LiveCloud, LiveSequence, Rig, str], None]:
    def work(cloud: LiveCloud, sequence: LiveSequence, rig: Rig, name: str) -> None:
        place = _place(folder, result)
        result.kept.append(keep_station(cloud, sequence, result.calibration, rig.identity, place, name))
        watcher.tell(f"{name} is kept: {cloud_text(cloud, result.calibration.unit)}.")
        join(tuple(result.kept))

    return work


def _place(folder: Path, result: LiveResult) -> Path:
    """Where the next station is kept."""
    return folder / CAPTURES_FOLDER / str(len(result.kept) + 1)


def _moved(config: Config, steps: int) -> Config:
    return config.model_copy(update={"rig": at_place_or_last(config.required_rig, steps)})


def _watch(
    rig: Rig,
    first_look: FirstLook,
    sequence: LiveSequence,
    result: LiveResult,
    keeper: Keeper,
    watcher: Watcher,
    *,
    one_only: bool,
) -> None:
    """Until all are kept, or one is if `one_only`."""
    begun = keeper.begun

    def on_round(cloud: LiveCloud | None, account: Account) -> None:
        watcher.on_round(cloud, account)
        if not (one_only and keeper.begun > begun):
            keeper.offer(cloud, sequence, rig)

    watch(
        take_rounds(rig, sequence, first_look.response),
        LiveDecoder(sequence, first_look, result.calibration),
        on_round,
        lambda: keeper.has_ended or (one_only and keeper.begun > begun),
        result.account,
    )
