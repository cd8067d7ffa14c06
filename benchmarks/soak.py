"""Whether a process that works all day stays as it was after its first hour, and its results the same.

    OPENBLAS_NUM_THREADS=1 python benchmarks/soak.py --minutes 10

Rounds of a scan, its replay, a measurement, an export, a refused replay and live clouds, all in this process, and now
and then one in a fresh process. After each round: memory, open files, threads, child processes, and what is left among
temporary files. Results of a round have to be the same, byte by byte but for their times, as those of the first. Ends
with exit code 1 if something differs or grows.
"""

import argparse
import gc
import hashlib
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np

from scanner.commands import main as run_command
from tests.support.small_room import CONFIG

_SETTLING = 5  # rounds in which caches fill
_MOST_MB = 20.0  # that the memory may drift by, by a line through all later rounds
_FRESH_EVERY = 20  # rounds
_TIME = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+:.\d]*")
_COMPARED = ("matches.npz", "calibration.yaml", "cloud.ply", "measure.json")


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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        own = Path(scratch) / "tmp"
        own.mkdir()
        os.environ["TMPDIR"] = tempfile.tempdir = str(own)
        return _soak(Path(scratch), own, 60 * options.minutes)


def _soak(scratch: Path, own: Path, seconds: float) -> int:
    config = scratch / "room.yaml"
    config.write_text(CONFIG)
    first: dict[str, str] | None = None
    usages = list[Usage]()
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s or len(usages) < 2 * _SETTLING:
        out = scratch / "work"
        is_fresh = len(usages) % _FRESH_EVERY == _FRESH_EVERY - 1
        _round(config, out, is_fresh=is_fresh)
        digests = {path: _digest(out / path) for path in _files(out)}
        first = first or digests
        if digests != first:
            different = sorted(path for path in {*digests, *first} if digests.get(path) != first.get(path))
            print(f"round {len(usages)} differs from the first: {', '.join(different)}")
            return 1
        subprocess.run(["rm", "-r", str(out)], check=True)
        usages.append(_usage(own))
        print(f"{len(usages):5d} " + "  ".join(f"{name} {value:g}" for name, value in _named(usages[-1])), flush=True)
    return _judge(usages)


def _round(config: Path, out: Path, *, is_fresh: bool) -> None:
    room, live = out / "room", ["--clouds", "2", "--calibration", str(out / "room" / "calibration.yaml")]
    common = ["--config", str(config), "--quiet"]
    _command(0, ["--out", str(room), *common], is_fresh=is_fresh)
    _command(0, ["replay", str(room / "capture"), "--out", str(out / "replay"), *common], is_fresh=is_fresh)
    _command(0, ["measure", str(room), "--out", str(out / "measured"), "--quiet"], is_fresh=is_fresh)
    _command(0, ["export", str(room), "--to", "e57", "--out", str(out / "room.e57"), "--quiet"], is_fresh=is_fresh)
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
    settled = usages[_SETTLING:]
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
