"""The job: look at a rig, show its clouds, and keep those that are wanted."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event

from calib.geometry import Calibration
from hw.ahead import beside
from hw.backends import RigSettings
from hw.errors import DeviceError
from hw.moving import at_place, turned_by_itself, turns_by_itself
from hw.rig import Rig
from scanner.checking.devices import opened
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.live.cloud import Decoder, LiveCloud
from scanner.live.first_look import FirstLook, look
from scanner.live.joining import FEWEST, joining
from scanner.live.keeping import keep
from scanner.live.rounds import rounds
from scanner.live.sequence import LiveSequence, sequence_for
from scanner.live.watching import Account, watch
from scanner.reconstruction import scaled
from scanner.results import CAPTURES_FOLDER, Decoded, new_result
from scanner.rooms.document import given_rig
from scanner.ui import Progress, Terminal

_SILENT = Terminal(quiet=True)


class Watcher:
    """Who looks, and may want things. Called from several threads; does nothing by itself."""

    def begin(self, calibration: Calibration, wishes: "Wishes") -> None:
        """Clouds of a calibrated rig are about to come; the wishes may be added to until they end."""

    def on_rig(self, rig: Rig) -> None:
        """The rig is open."""

    def on_cloud(self, cloud: LiveCloud, account: Account) -> None:
        """There is a new one."""

    def tell(self, sentence: str) -> None:
        """Something that is to be known."""


@dataclass
class Wishes:
    """`number`: of clouds to keep, then it ends; `every_s`: keep one so often; `now`: keep the next one; `end`."""

    number: int | None = None
    every_s: float | None = None
    now: Event = field(default_factory=Event)
    end: Event = field(default_factory=Event)

    def due(self, kept: int, last_s: float) -> bool:
        """Whether to keep the cloud that has just come; the one before was kept at `last_s`, by `time.monotonic`."""
        if self.number is not None and kept >= self.number:
            return False
        if self.every_s is not None:
            return time.monotonic() - last_s >= self.every_s or self.now.is_set()
        return self.number is not None or self.now.is_set()


class Watchers(Watcher):
    """Several who look."""

    def __init__(self, *watchers: Watcher) -> None:
        self._watchers = watchers

    def begin(self, calibration: Calibration, wishes: Wishes) -> None:
        """As of each."""
        for each in self._watchers:
            each.begin(calibration, wishes)

    def on_rig(self, rig: Rig) -> None:
        """As of each."""
        for each in self._watchers:
            each.on_rig(rig)

    def on_cloud(self, cloud: LiveCloud, account: Account) -> None:
        """As of each."""
        for each in self._watchers:
            each.on_cloud(cloud, account)

    def tell(self, sentence: str) -> None:
        """As of each."""
        for each in self._watchers:
            each.tell(sentence)


@dataclass
class Looked:
    """What came of it. `kept`: the stations; `ended_by`: what ended it before all were there, None if nothing did."""

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
    terminal: Terminal = _SILENT,
    progress: Progress | None = None,
    watcher: Watcher,
) -> Looked:
    """Until `wishes` or Ctrl-C end it. What was kept becomes `out`, also where a device fails; nothing does if nothing
    was. `depths`: between which everything is, in the calibration's unit. `progress` is told of it in place of the
    `terminal`.

    Raises InputError, DeviceError, RefusalError; KeyboardInterrupt, also where `wishes` end it with nothing kept.
    """
    start = given_rig(calibration, config)
    known = scaled(start.given or start.calibration, None, config.scale)
    if wishes.number is not None and wishes.number < 1:
        raise InputError(f"--clouds: expected 1 or more, found {wishes.number}")
    _refuse_missing_places(config.required_rig, wishes.number)
    found = Looked(known)
    watcher.begin(known, wishes)
    with new_result(out, config, overwrite=overwrite, keep_capture=True, tell=terminal.note) as folder:
        try:
            _look_on(config, folder, found, wishes, depths, progress or terminal, watcher)
            if not found.kept:
                raise KeyboardInterrupt
        except (KeyboardInterrupt, DeviceError) as error:
            if not found.kept:
                raise
            found.ended_by = error
    if found.ended_by is not None:
        found.ended_by.add_note(f"What was kept is in {out}.")
    return found


def _refuse_missing_places(settings: RigSettings, number: int | None) -> None:
    if not turns_by_itself(settings):
        return
    try:
        at_place(settings, (number or 1) - 1)
    except DeviceError as error:
        raise InputError(f"--clouds {number}: {error}") from error


def _look_on(
    config: Config,
    folder: Path,
    found: Looked,
    wishes: Wishes,
    depths: tuple[float, float] | None,
    progress: Progress,
    watcher: Watcher,
) -> None:
    first: tuple[FirstLook, LiveSequence] | None = None
    with joining(found.calibration, watcher.tell) as join, beside(_keeping(folder, found, join, watcher)) as begin:
        keeper = Keeper(wishes, begin)
        while not keeper.has_ended:
            begun = keeper.begun
            with ExitStack() as devices:
                with progress.step("Preparing the rig"):
                    rig = devices.enter_context(opened(_turned(config, begun)))
                if first is None:
                    with progress.step("Looking at light and dark"):
                        seen = look(rig, config)
                        first = seen, sequence_for(found.calibration, seen, depths)
                watcher.on_rig(rig)
                _watch(rig, *first, found, keeper, watcher, turns=turns_by_itself(config.required_rig))


@dataclass
class Keeper:
    """Has clouds kept by `begin` when they are due. `begun`: how many that was."""

    wishes: Wishes
    begin: Callable[[LiveCloud, LiveSequence, Rig, str], None]
    begun: int = 0
    _last_s: float = field(default_factory=time.monotonic)

    @property
    def has_ended(self) -> bool:
        """Whether nobody wants more."""
        return self.wishes.end.is_set() or self.begun == self.wishes.number

    def offer(self, cloud: LiveCloud, sequence: LiveSequence, rig: Rig) -> None:
        """A cloud that has just come."""
        if self.wishes.due(self.begun, self._last_s) and len(cloud.points):
            self.wishes.now.clear()
            self._last_s = time.monotonic()
            self.begun += 1
            self.begin(cloud, sequence, rig, f"Station {self.begun}")


def _keeping(
    folder: Path, found: Looked, join: Callable[[Sequence[Decoded]], None], watcher: Watcher
) -> Callable[[LiveCloud, LiveSequence, Rig, str], None]:
    def work(cloud: LiveCloud, sequence: LiveSequence, rig: Rig, name: str) -> None:
        place = folder / CAPTURES_FOLDER / str(len(found.kept) + 1)
        found.kept.append(keep(cloud, sequence, found.calibration, rig.identity, place, name))
        watcher.tell(f"{name} is kept.")
        if len(found.kept) >= FEWEST:
            join(tuple(found.kept))

    return work


def _turned(config: Config, kept: int) -> Config:
    """A simulated thing is turned after each cloud that is kept, as long as there are places; what is real, by hand."""
    return config.model_copy(update={"rig": turned_by_itself(config.required_rig, kept)})


def _watch(
    rig: Rig,
    seen: FirstLook,
    sequence: LiveSequence,
    found: Looked,
    keeper: Keeper,
    watcher: Watcher,
    *,
    turns: bool,
) -> None:
    """Until all are kept or, of a thing that turns by itself, one is."""
    begun = keeper.begun

    def on_cloud(cloud: LiveCloud, account: Account) -> None:
        watcher.on_cloud(cloud, account)
        if not (turns and keeper.begun > begun):
            keeper.offer(cloud, sequence, rig)

    watch(
        rounds(rig, sequence, seen.response),
        Decoder(sequence, seen, found.calibration),
        on_cloud,
        lambda: keeper.has_ended or (turns and keeper.begun > begun),
        found.account,
    )
