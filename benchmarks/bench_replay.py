"""Processor time of `scan replay`, relative to reading the frames with OpenCV in the same run.

    python benchmarks/bench_replay.py [--captures DIR] [--repeat 3]

Times are processor seconds, which depend less on other work on the machine. An untimed replay loads the machine code,
or compiles it.
"""

import argparse
import contextlib
import io
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
from rich.console import Console
from rich.table import Table

from scanner.capture import CAPTURE_FILE, open_capture
from scanner.commands import main as scan

CAPTURES = Path(__file__).parents[2] / "shared" / "data"
_MOST_READINGS = 5


def processor_s(action: Callable[[], object], repeat: int) -> float:
    """Processor seconds; the minimum of several runs, because other work only adds to it."""
    found = []
    for _ in range(repeat):
        begin_s = time.process_time()
        action()
        found.append(time.process_time() - begin_s)
    return min(found)


def read(files: list[Path]) -> None:
    """Read all frames from their files."""
    for file in files:
        if cv2.imread(str(file), cv2.IMREAD_UNCHANGED) is None:
            raise SystemExit(f"{file}: OpenCV cannot read it")


def replay(capture: Path) -> int:
    """The exit code; a capture without a corner is decoded, too."""
    with tempfile.TemporaryDirectory(prefix="replay-") as folder, contextlib.redirect_stderr(io.StringIO()):
        return scan(["replay", str(capture), "--out", str(Path(folder) / "result"), "--quiet"])


def main() -> None:
    options = _options()
    captures = sorted(listing.parent for listing in options.captures.rglob(CAPTURE_FILE))
    if not captures:
        sys.exit(f"no captures in {options.captures}: name a folder of capture folders with --captures")
    table = Table(title="Replaying real captures, in seconds of the processors")
    for column in ("capture", "frames", "camera", "reading", "replay", f"replay / reading (limit {_MOST_READINGS})"):
        table.add_column(column, justify="left" if column == "capture" else "right")
    for capture in captures:
        recording = open_capture(capture)
        files = [capture / file for file in recording.files]
        replay(capture)
        reading_s = processor_s(partial(read, files), options.repeat)
        replay_s = processor_s(partial(replay, capture), options.repeat)
        figures = f"{reading_s:.2f}", f"{replay_s:.2f}", f"{replay_s / reading_s:.1f}"
        size = "{} × {}".format(*recording.camera_size)
        table.add_row(str(capture.relative_to(options.captures)), str(len(files)), size, *figures)
    Console().print(table)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, default=CAPTURES, metavar="DIR", help="capture folders, however deep")
    parser.add_argument("--repeat", type=int, default=3, help="number of runs; the shortest counts")
    return parser.parse_args()


if __name__ == "__main__":
    main()
