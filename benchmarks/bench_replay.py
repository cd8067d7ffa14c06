"""Processor time of `scan replay`, relative to reading the frames with OpenCV in the same run.

    python benchmarks/bench_replay.py [--captures DIR] [--repeat 3] [--megapixels 5 20]

Times are processor seconds, which depend less on other work on the machine. An untimed replay loads the machine code,
or compiles it.

With --megapixels, corners that fill the picture of cameras of these sizes are replayed instead, by commands of their
own: their time by the clock, and their peak memory, beside the limits for 20 megapixels.
"""

import argparse
import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import cv2
from bench_decode import seen_by_camera
from bench_end_to_end import CAMERA, PROJECTOR, corner_seen
from rich.console import Console
from rich.table import Table

from calib.geometry import Intrinsics
from hw.rig import Frame
from scanner.capture import CAPTURE_FILE, Stream, open_capture, record
from scanner.commands import main as scan
from scanner.patterns import Black, Pattern, White, gray_sequence, sequence_for

CAPTURES = Path(__file__).parents[2] / "shared" / "data"
_MOST_READINGS = 5
_CONFIG = "rig.yaml"
_MOST_S, _MOST_BYTES = 12.0, 2e9  # at 20 megapixels


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


def _scaled(camera: Intrinsics, megapixels: float) -> Intrinsics:
    """A camera with the same view and this many pixels."""
    factor = (1e6 * megapixels / (camera.width * camera.height)) ** 0.5
    return Intrinsics(
        round(factor * camera.width),
        round(factor * camera.height),
        (factor * camera.focal_px[0], factor * camera.focal_px[1]),
        (factor * camera.principal_point_px[0], factor * camera.principal_point_px[1]),
        camera.distortion,
    )


@dataclass(frozen=True)
class Used:
    """What a command took."""

    clock_s: float
    """Seconds by the clock."""
    processors_s: float
    """Processor seconds."""
    peak_bytes: float
    """Largest memory in use."""


def _replayed_alone(capture: Path, out: Path) -> Used:
    """Replay in a process of its own. Raises CalledProcessError if the command fails; a fair result is none."""
    command = [sys.executable, "-m", "scanner", "replay", str(capture), "--out", str(out), "--quiet"]
    command += ["--config", str(capture.with_name(_CONFIG))]
    begin_s = time.perf_counter()
    process = subprocess.Popen(command)
    _, status, usage = os.wait4(process.pid, 0)
    clock_s = time.perf_counter() - begin_s
    if code := os.waitstatus_to_exitcode(status):
        raise subprocess.CalledProcessError(code, command)
    return Used(clock_s, usage.ru_utime + usage.ru_stime, 1024.0 * usage.ru_maxrss)


def write_corner(folder: Path, megapixels: float, *, fringes: bool) -> Path:
    """A capture folder of a white corner that fills the picture, with what is known of the rig beside it.

    `fringes`: of the standard sequence, else of Gray code alone.
    """
    camera, size = _scaled(CAMERA, megapixels), (PROJECTOR.width, PROJECTOR.height)
    patterns: tuple[Pattern, ...] = sequence_for(size)
    if not fringes:
        patterns = (White(), Black(), *gray_sequence("x", size[0], 1), *gray_sequence("y", size[1], 1))
    images = seen_by_camera(patterns, size, *corner_seen(camera, PROJECTOR))
    frames = ((pattern, Frame(image)) for pattern, image in zip(patterns, images, strict=True))
    stream = Stream(patterns, PROJECTOR.size, camera.size, frames)
    deque(record(stream, folder).frames, 0)
    known = {"width": camera.width, "height": camera.height, "principal_point": {"known": [*camera.principal_point_px]}}
    projector = {"width": size[0], "height": size[1]}
    config = {"camera": known, "projector": projector, "corner": {"squareness_deg": 0}}
    folder.with_name(_CONFIG).write_text(json.dumps(config))
    return folder


def large(sizes: Sequence[float], console: Console) -> None:
    """Replays of large captures, each by a command of its own."""
    table = Table(title=f"Replaying large captures (limits at 20 megapixels: {_MOST_S:g} s, {_MOST_BYTES / 1e9:g} GB)")
    for column in ("megapixels", "sequence", "frames", "reading", "replay", "processors", "memory", "bytes a pixel"):
        table.add_column(column, justify="left" if column == "sequence" else "right")
    for megapixels in sizes:
        for fringes in (True, False):
            with tempfile.TemporaryDirectory(prefix="replay-") as place:
                # In another process: a child's peak includes that of the process from which it was forked.
                with ProcessPoolExecutor(1, get_context("spawn")) as process:
                    written = process.submit(write_corner, Path(place) / "capture", megapixels, fringes=fringes)
                capture = written.result()
                files = [capture / file for file in open_capture(capture).files]
                begin_s = time.perf_counter()
                read(files)
                reading_s = time.perf_counter() - begin_s
                used = _replayed_alone(capture, Path(place) / "result")
            table.add_row(
                f"{megapixels:g}",
                "fringes" if fringes else "Gray code",
                str(len(files)),
                f"{reading_s:.1f} s",
                f"{used.clock_s:.1f} s",
                f"{used.processors_s:.1f} s",
                f"{used.peak_bytes / 1e9:.2f} GB",
                f"{used.peak_bytes / (1e6 * megapixels):.0f}",
            )
    console.print(table)


def main() -> None:
    options = _options()
    if options.megapixels:
        large(options.megapixels, Console())
        return
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
    parser.add_argument(
        "--megapixels", type=float, nargs="+", metavar="N", help="replay corners of these sizes instead"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
