"""How long it takes from the last frame until everything is saved, and where the time goes.

    python benchmarks/bench_end_to_end.py [--repeat 3] [--profile 30]

A white corner fills the picture of the paper's camera (5 megapixels), so nearly every pixel is matched. Both lenses
bend. The standard sequence is decoded as it comes; then matches, calibration, cloud and report are written. CPU seconds
beside those of the clock tell how far two cores were used, and what other load on the machine cost.
"""

import argparse
import cProfile
import pstats
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from bench_decode import seen_by_camera
from rich.console import Console
from rich.table import Table

from calib.arrays import Image
from calib.camera import Intrinsics
from calib.synthetic import PAPER_CAMERA, look_at
from hw.rig import Frame
from scanner.capture import Stream
from scanner.config import Config
from scanner.decoding.arrays import Floats32
from scanner.findings import Scan
from scanner.patterns import Pattern, sequence_for
from scanner.pipeline import decode, reconstruct
from scanner.terminal import Terminal

CAMERA = replace(PAPER_CAMERA, distortion=(-0.02, 0.0, 0.0, 0.0, 0.0))
PROJECTOR = Intrinsics(1920, 1200, (950.0, 950.0), (955.0, 640.0), (-0.01, 0.0, 0.0, 0.0, 0.0))
_CAMERA_AT, _PROJECTOR_AT = np.array([1.9, 2.3, 1.5]), np.array([2.3, 1.9, 1.8])
_UP = np.array([0.0, 0.0, 1.0])


@dataclass
class Stopwatch(Terminal):
    """A terminal that notes how long each step takes: seconds by the clock and by the processors."""

    steps: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__init__(quiet=True)

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        clock, processors = time.perf_counter(), time.process_time()
        yield
        self.steps[what] = time.perf_counter() - clock, time.process_time() - processors


def corner_seen(camera: Intrinsics, projector: Intrinsics) -> tuple[Floats32, Floats32]:
    """The projector pixel (H, W, 2) that each camera pixel sees, and the light (H, W) it returns, 0 to 1."""
    camera_axes = look_at(_CAMERA_AT, np.zeros(3), _UP, 0.05)
    projector_axes = look_at(_PROJECTOR_AT, np.array([0.1, 0.0, 0.1]), _UP, -0.03)
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.unproject(np.stack([columns, rows], axis=-1).astype(np.float64)) @ camera_axes
    with np.errstate(divide="ignore"):
        lengths = np.where(rays < 0, -_CAMERA_AT / rays, np.inf)
    wall = np.argmin(lengths, axis=-1)
    points = _CAMERA_AT + np.min(lengths, axis=-1)[..., None] * rays
    to_projector = _PROJECTOR_AT - points
    distance = np.linalg.norm(to_projector, axis=-1)
    slant = np.take_along_axis(to_projector, wall[..., None], axis=-1)[..., 0] / distance
    light = slant / distance**2
    pixels = projector.project(-to_projector @ projector_axes.T)
    return pixels.astype(np.float32), (0.95 * light / light.max()).astype(np.float32) ** np.float32(0.5)


def stream_of(
    frames: list[Image], patterns: tuple[Pattern, ...], camera: Intrinsics, last: list[tuple[float, float]]
) -> Stream:
    """The frames as they would come; when the last one does is noted in `last`."""

    def as_they_come() -> Iterator[tuple[Pattern, Frame]]:
        for number, (pattern, image) in enumerate(zip(patterns, frames, strict=True), start=1):
            if number == len(frames):
                last.append((time.perf_counter(), time.process_time()))
            yield pattern, Frame(image)

    return Stream(patterns, (PROJECTOR.width, PROJECTOR.height), (camera.width, camera.height), as_they_come())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=3, help="runs, each of which is shown")
    parser.add_argument("--profile", type=int, default=0, metavar="N", help="functions of a last, slower run to list")
    options = parser.parse_args()
    camera = CAMERA
    patterns = sequence_for((PROJECTOR.width, PROJECTOR.height))
    frames = [*seen_by_camera(patterns, (PROJECTOR.width, PROJECTOR.height), *corner_seen(camera, PROJECTOR))]
    known = {"known": list(camera.principal_point_px)}
    config = Config.model_validate({"camera": {"principal_point": known}, "corner": {"squareness_deg": 0.0}})

    runs, matched = [], 0
    profile = cProfile.Profile()
    for number in range(options.repeat + (options.profile > 0)):
        is_profiled = number == options.repeat
        watch, last = Stopwatch(), list[tuple[float, float]]()
        with tempfile.TemporaryDirectory() as folder, profile if is_profiled else nullcontext():
            found = decode(stream_of(frames, patterns, camera, last), watch, "Decoding")
            reconstruct(Scan([found]), config, Path(folder), watch)
        (clock, processors) = last[0]
        watch.steps["from the last frame to everything saved"] = (
            time.perf_counter() - clock,
            time.process_time() - processors,
        )
        matched = len(found.matches)
        if not is_profiled:
            runs.append(watch.steps)

    share = matched / (camera.width * camera.height)
    table = Table(title=f"{camera.width} × {camera.height}, {len(frames)} frames, {matched:,} matches ({share:.0%})")
    table.add_column("stage")
    for number in range(len(runs)):
        table.add_column(f"run {number + 1}: s (CPU s)", justify="right")
    for stage in runs[0]:
        table.add_row(stage, *(f"{run[stage][0]:.2f} ({run[stage][1]:.2f})" for run in runs))
    Console(width=120).print(table)
    if options.profile:
        pstats.Stats(profile).sort_stats("cumulative").print_stats(r"/(scanner|calib)/", options.profile)


if __name__ == "__main__":
    main()
