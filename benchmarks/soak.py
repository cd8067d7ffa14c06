"""Whether a process that works all day stays as it was after its first hour, and its results the same.

    OPENBLAS_NUM_THREADS=1 python benchmarks/soak.py --minutes 10
    OPENBLAS_NUM_THREADS=1 python benchmarks/soak.py --small --rounds 2000

Rounds of a scan, its replay, a measurement, an export, a refused replay and live clouds, all in this process, and now
and then one in a fresh process, or a whole room from three stations; between them a console's worker, the same all day,
looks, checks, scans and shows clouds. A small round is of small pictures, a scan, its replay and a live cloud: nine of
ten are, each in about a second. After each round: memory, open files, threads, child processes, and what is left
among temporary files. Results of a round have to be the same, byte by byte but for their times, as those of the first.
Ends with exit code 1 if something differs or grows.
"""

import argparse
import contextlib
import gc
import hashlib
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from hw.rig import Frame, Rig
from scanner.checking import CheckReport, CheckRow
from scanner.commands import main as run_command
from scanner.console import Activity, ConsoleSettings, Status, Worker
from scanner.live import Watcher
from scanner.networks import PairProgress
from scanner.results import Scan
from tests.support.places import ROOT
from tests.support.small_capture import CONFIG

_SETTLING = 5  # rounds in which caches fill
_MOST_MB = 20.0  # that the memory may drift by, by a line through the second half of the rounds
_WHOLE_EVERY = 10  # small rounds
_ROOM = (
    *("--config", str(ROOT / "configs/room-whole-sim.yaml"), "--stations", "3", "--set", "sequence.preset=quick"),
    *("--set", "camera={width: 306, height: 256}", "--set", "projector={width: 427, height: 240}", "--quiet"),
)
_LIVE_FRAMES, _LIVE_CLOUDS = 5, 2
_PATIENCE_S = 600.0  # on a busy machine
_TIME = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+:.\d]*")
_COMPARED = ("matches.npz", "calibration.yaml", "cloud.ply", "measure.json", "mapping.yaml", "room.yaml", "room.ply")


_SMALL_CONFIG = """
rig: {backend: simulated, furniture: false, interreflection: false, ambient: 0}
camera: {width: 204, height: 170, principal_point: {known: [104.5, 87.7]}}
projector: {width: 142, height: 80}
sequence: {preset: quick}
corner: {squareness_deg: 0}
"""


@dataclass(frozen=True)
class Course:
    """What is done how often."""

    # The configuration's text.
    config: str
    # The most rounds.
    rounds: int
    # No round begins later, unless memory has not settled yet.
    seconds: float
    # All commands in each so many rounds; in the others a scan, its replay and a cloud.
    whole_every: int
    # Each so many rounds all commands are processes of their own, and a whole room is scanned.
    fresh_every: int
    room_every: int


@dataclass(frozen=True)
class Usage:
    """What this process has."""

    # Resident memory, in MB.
    memory_mb: float
    # Open files, sockets and pipes.
    handles: int
    threads: int
    # Processes that it has started and not waited for.
    children: int
    # Files and folders that were left among temporary ones.
    temporary: int


class SilentPage:
    """A page of the console that shows nothing, and notices how far its worker is."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._wanted, self._began, self._ended, self._seen = Activity.NOTHING, False, False, 0
        self.message = ""

    def expect(self, activity: Activity) -> None:
        """Before it is asked for: what was done until then may end first."""
        with self._changed:
            self._wanted, self._began, self._ended, self._seen, self.message = activity, False, False, 0, ""

    def wait_for_end(self) -> None:
        """Of what was asked for. Raises TimeoutError."""
        self._wait(lambda: self._ended)

    def wait_for_sights(self, count: int) -> None:
        """Of frames or clouds, or the end. Raises TimeoutError."""
        self._wait(lambda: self._seen >= count or self._ended)

    def _wait(self, condition: Callable[[], bool]) -> None:
        with self._changed:
            if not self._changed.wait_for(condition, _PATIENCE_S):
                raise TimeoutError(f"the console's worker was not ready within {_PATIENCE_S:.0f} s")

    def _see(self) -> None:
        with self._changed:
            self._seen += 1
            self._changed.notify_all()

    def on_status(self, status: Status) -> None:
        with self._changed:
            self._began |= status.activity is self._wanted
            if self._began and status.activity is Activity.NOTHING:
                self._ended, self.message = True, status.message
            self._changed.notify_all()

    def on_frame(self, frame: Frame, camera: str = "") -> None:  # noqa: ARG002
        self._see()

    def on_camera(self, rig: Rig) -> None: ...

    def on_sight(self, sight: PairProgress, frame: Frame | None) -> None: ...

    def on_captured(self) -> None: ...

    def on_row(self, row: CheckRow) -> None: ...

    def on_report(self, report: CheckReport) -> None: ...

    def on_cloud(self, scan: Scan) -> None: ...

    def on_result(self, folder: Path) -> None: ...

    def live_watcher(self) -> Watcher:
        return SightWatcher(self._see)


class SightWatcher(Watcher):
    """Counts live clouds."""

    def __init__(self, see: Callable[[], None]) -> None:
        self._see = see

    def on_round(self, *_: object) -> None:
        self._see()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, help="begin rounds for so long (default: 10, or as --rounds says)")
    parser.add_argument("--rounds", type=int, help="end after so many (default: as --minutes says)")
    parser.add_argument("--small", action="store_true", help="small pictures, and nine of ten rounds without the rest")
    parser.add_argument("--fresh", action="store_true", help="every command of every round in a process of its own")
    options = parser.parse_args()
    if options.rounds is not None and options.rounds < 2 * _SETTLING:
        parser.error(f"--rounds: expected {2 * _SETTLING} or more: caches fill in the first {_SETTLING}")
    minutes = options.minutes or (float("inf") if options.rounds else 10.0)
    course = Course(
        _SMALL_CONFIG if options.small else CONFIG,
        options.rounds or sys.maxsize,
        60 * minutes,
        whole_every=_WHOLE_EVERY if options.small else 1,
        fresh_every=1 if options.fresh else 20 * (_WHOLE_EVERY if options.small else 1),
        room_every=100 if options.small else 10,
    )
    with tempfile.TemporaryDirectory() as scratch:
        own = Path(scratch) / "tmp"
        own.mkdir()
        os.environ["TMPDIR"] = tempfile.tempdir = str(own)
        return _soak(Path(scratch), own, course)


def _soak(scratch: Path, own: Path, course: Course) -> int:
    config = scratch / "room.yaml"
    config.write_text(course.config)
    page = SilentPage()
    worker = Worker(ConsoleSettings(config), page)
    worker.start()
    first = dict[str, str]()
    usages = list[Usage]()
    end_s = time.monotonic() + course.seconds
    while len(usages) < course.rounds and (time.monotonic() < end_s or len(usages) < 2 * _SETTLING):
        out, number = scratch / "work", len(usages)
        out.mkdir()
        with contextlib.chdir(out):  # where the console leaves its scans
            is_whole = number % course.whole_every == 0
            if is_whole:
                _work(worker, page)
            _round(config, out, is_whole=is_whole, is_fresh=number % course.fresh_every == course.fresh_every - 1)
            if number % course.room_every == 0:
                _command(0, [*_ROOM, "--out", str(out / "whole")], is_fresh=False)
        digests = {path: _digest(out / path) for path in _files(out)}
        different = sorted(path for path, digest in digests.items() if first.setdefault(path, digest) != digest)
        if different:
            print(f"round {number} differs from the first: {', '.join(different)}")
            return 1
        subprocess.run(["rm", "-r", str(out)], check=True)
        usages.append(_usage(own))
        print(f"{len(usages):5d} " + "  ".join(f"{name} {value:g}" for name, value in _named(usages[-1])), flush=True)
    worker.close()
    return _judge(usages)


def _work(worker: Worker, page: SilentPage) -> None:
    """A look at the rig, a check, a scan and live clouds, by a console's worker."""
    for activity, sights in (
        (Activity.LIVE, _LIVE_FRAMES),
        (Activity.CHECKING, 0),
        (Activity.SCANNING, 0),
        (Activity.CLOUDS, _LIVE_CLOUDS),
    ):
        page.expect(activity)
        if not worker.request(activity):
            raise SystemExit(f"console: {activity} was refused")
        if sights:
            page.wait_for_sights(sights)
        if activity is Activity.LIVE:
            continue  # until something else is asked for
        if activity is Activity.CLOUDS:
            worker.cancel()
        page.wait_for_end()
        if page.message:
            raise SystemExit(f"console: {activity}: {page.message}")


def _round(config: Path, out: Path, *, is_whole: bool, is_fresh: bool) -> None:
    room = out / "room"
    live = ["--clouds", str(2 if is_whole else 1), "--calibration", str(room / "calibration.yaml")]
    common = ["--config", str(config), "--quiet"]
    _command(0, ["--out", str(room), *common], is_fresh=is_fresh)
    _command(0, ["replay", str(room / "capture"), "--out", str(out / "replay"), *common], is_fresh=is_fresh)
    if is_whole:
        _command(0, ["measure", str(room), "--out", str(out / "measured"), "--quiet"], is_fresh=is_fresh)
        _command(0, ["export", str(room), "--to", "e57", "--out", str(out / "room.e57"), "--quiet"], is_fresh=is_fresh)
        _command(0, ["export", str(room), "--to", "mapping", "--out", str(out / "maps"), "--quiet"], is_fresh=is_fresh)
        _command(2, ["replay", str(out / "nowhere"), "--out", str(out / "refused"), *common], is_fresh=is_fresh)
    _command(0, ["live", *live, "--out", str(out / "live"), *common], is_fresh=is_fresh)


def _command(code: int, arguments: list[str], *, is_fresh: bool) -> None:
    if is_fresh:
        found = subprocess.run([sys.executable, "-m", "scanner", *arguments], capture_output=True).returncode
    else:
        found = run_command(arguments)
    if found != code:
        raise SystemExit(f"scan {' '.join(arguments)}: expected exit code {code}, found {found}")


def _files(folder: Path) -> list[str]:
    """What has to be the same in every round: results; not logs and reports, which say when they were made."""
    paths = (path for path in folder.rglob("*") if path.name in _COMPARED and "live" not in path.parts)
    return sorted(str(path.relative_to(folder)) for path in paths)


def _digest(file: Path) -> str:
    """Of all but the times."""
    return hashlib.sha256(_TIME.sub(b"", file.read_bytes())).hexdigest()


def _usage(own: Path) -> Usage:
    gc.collect()
    status = Path("/proc/self/status").read_text().splitlines()
    memory_kb = next(int(line.split()[1]) for line in status if line.startswith("VmRSS:"))
    tasks = Path("/proc/self/task").iterdir()
    children = sum(len((task / "children").read_text().split()) for task in tasks)
    handles, temporary = len(list(Path("/proc/self/fd").iterdir())), len(list(own.iterdir()))
    return Usage(memory_kb / 1024, handles, threading.active_count(), children, temporary)


def _named(usage: Usage) -> list[tuple[str, float]]:
    return list(zip((field.name for field in fields(usage)), astuple(usage), strict=True))


def _judge(usages: list[Usage]) -> int:
    """Print by how much each rose from when it had settled to the end; memory by a line through the rounds."""
    settled = usages[max(_SETTLING, len(usages) // 2) :]
    memory = np.array([usage.memory_mb for usage in settled])
    drift_mb = float(np.polyfit(np.arange(len(memory)), memory, 1)[0]) * len(memory)
    print(f"{len(usages)} rounds; memory drifted by {drift_mb:+.1f} MB in the last {len(settled)}")
    grown = [
        name
        for (name, before), (_, after) in zip(_named(settled[0]), _named(settled[-1]), strict=True)
        if name != "memory_mb" and after > before
    ]
    for name in grown:
        print(f"{name} grew")
    return int(bool(grown) or drift_mb > _MOST_MB)


if __name__ == "__main__":
    raise SystemExit(main())
