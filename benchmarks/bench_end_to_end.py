"""Time from the last frame until everything is saved, by stage.

    python benchmarks/bench_end_to_end.py [--repeat 3] [--profile 30]

A white corner fills the picture of the paper's camera (5 megapixels), so nearly every pixel is matched. Both lenses
have distortion. The standard sequence is decoded as frames arrive; then matches, calibration, cloud and report are
written. CPU seconds beside those of the clock show how far two cores were used, and the cost of other load on the
machine.

A plain copy is one of all frames into a single piece of new memory. When the limits were set, each frame was copied
into its own memory, which takes more or less time depending on the allocator: both are printed.

A first run, which loads libraries and machine code, is not shown; a running console has done this before. While the
result is written, its files and the report's parts are made in parallel, so their times by the clock overlap, and their
CPU seconds are those of their own threads.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as every command does, before NumPy is imported

import argparse
import cProfile
import pstats
import tempfile
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_decode import seen_by_camera
from rich.console import Console
from rich.table import Table
from stopwatch import Duration, PlainCopy, Stopwatch, plain_copy

from calib.geometry import Intrinsics
from calib.numerics import Image
from calib.synthetic import PAPER_CAMERA, look_at
from hw.rig import Frame
from scanner.acquisition import decode
from scanner.capture import Stream
from scanner.configuration import Config
from scanner.decoding import Floats32
from scanner.patterns import Pattern, sequence_for
from scanner.reconstruction import reconstruct
from scanner.reporting import page as report

CAMERA = replace(PAPER_CAMERA, distortion=(-0.02, 0.0, 0.0, 0.0, 0.0))
PROJECTOR = Intrinsics(1920, 1200, (950.0, 950.0), (955.0, 640.0), (-0.01, 0.0, 0.0, 0.0, 0.0))
# Limits in plain copies of all frames, in the same run.
TO_CLOUD, TOTAL = "from the last frame to the cloud", "from the last frame to everything saved"
LIMITS = {TO_CLOUD: 12.0, TOTAL: 20.0}
WRITING = "Writing the result"
ALONE = {
    "coordinates of all pixels": "scanner.decoding.decoder.decode_tiles",
    "faces": "scanner.reconstruction.calibrate.find_faces",
    "cells": "calib.self_calibration.rig.into_cells",
    "paper's objective": "calib.self_calibration.rig.family_of",
    "sweep": "calib.refinement.refine.sweep_one",
    "its minima": "calib.refinement.refine.explore",
    "refinement": "calib.refinement.refine.settle",
    "triangulation": "calib.pointcloud.organised_cloud.organise",
    "surface": "calib.pointcloud.organised_cloud.surface",
}
BESIDE = {
    "matches file": "scanner.reconstruction.save.write_matches",
    "cloud file": "scanner.reconstruction.save.write_ply",
    "report, all of it": "scanner.reconstruction.save.write_report",
}
_CAMERA_AT, _PROJECTOR_AT = np.array([1.9, 2.3, 1.5]), np.array([2.3, 1.9, 1.8])
_UP = np.array([0.0, 0.0, 1.0])


def corner_seen(camera: Intrinsics, projector: Intrinsics) -> tuple[Floats32, Floats32]:
    """The projector pixel (H, W, 2) that each camera pixel sees, and its relative brightness (H, W), 0 to 1."""
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
    """The frames as from a camera; the time of the last one is appended to `last`."""

    def as_they_come() -> Iterator[tuple[Pattern, Frame]]:
        for number, (pattern, image) in enumerate(zip(patterns, frames, strict=True), start=1):
            if number == len(frames):
                last.append((time.perf_counter(), time.process_time()))
            yield pattern, Frame(image)

    return Stream(patterns, PROJECTOR.size, camera.size, as_they_come())


def one_run(frames: list[Image], patterns: tuple[Pattern, ...], profile: cProfile.Profile | None = None) -> Stopwatch:
    """Decode, calibrate, triangulate and save, timed; a `profile` makes it slower."""
    known = {"known": list(CAMERA.principal_point_px)}
    config = Config.model_validate({"camera": {"principal_point": known}, "corner": {"squareness_deg": 0.0}})
    watch, last = Stopwatch(), list[tuple[float, float]]()
    watched = watch.watched(ALONE, BESIDE, report.PARTS, "report: ")
    with tempfile.TemporaryDirectory() as folder, watched, profile or nullcontext():
        (decoded,) = decode([stream_of(frames, patterns, CAMERA, last)], watch, "Decoding")
        reconstruct([decoded], config, Path(folder), watch)
    clock, processors = last[0]
    watch.steps[TOTAL] = Duration(time.perf_counter() - clock, time.process_time() - processors)
    writing = watch.steps[WRITING]
    watch.steps[TO_CLOUD] = Duration(
        watch.steps[TOTAL].clock_s - writing.clock_s, watch.steps[TOTAL].processors_s - writing.processors_s
    )
    watch.matched = len(decoded.matches)
    return watch


def table_of(runs: list[Stopwatch], copies: list[PlainCopy], title: str) -> Table:
    """Steps with their parts, a column for each run; for the total, the ratio to plain copies and to its limit."""
    table = Table(title=title)
    table.add_column("stage")
    for number in range(1, len(runs) + 1):
        table.add_column(f"run {number}: s (CPU s)", justify="right")
    first = runs[0]
    for step in first.steps:
        table.add_row(step, *(str(run.steps[step]) for run in runs), style="bold")
        if step in LIMITS:
            for how, copies_s in (
                ("plain copies", [copy.in_one_piece_s for copy in copies]),
                ("frame by frame", [copy.frame_by_frame_s for copy in copies]),
            ):
                found = [run.steps[step].clock_s / copy_s for run, copy_s in zip(runs, copies_s, strict=True)]
                shown = (f"{each:.1f} ({each / LIMITS[step]:.2f})" for each in found)
                table.add_row(f"  {how} (of limit, {LIMITS[step]:g})", *shown)
        parts = first.parts[step]
        # Parallel parts end in any order.
        for part in sorted(parts, key=lambda each: -parts[each].clock_s) if step == WRITING else parts:
            table.add_row(f"  {part}", *(str(run.parts[step][part]) for run in runs))
        if parts and step != WRITING:
            table.add_row("  the rest", *(str(run.rest(step)) for run in runs))
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=3, help="runs, each of which is shown")
    parser.add_argument("--profile", type=int, default=0, metavar="N", help="functions of a last, slower run to list")
    options = parser.parse_args()
    patterns = sequence_for((PROJECTOR.width, PROJECTOR.height))
    frames = [*seen_by_camera(patterns, (PROJECTOR.width, PROJECTOR.height), *corner_seen(CAMERA, PROJECTOR))]

    one_run(frames, patterns)
    copies, runs = [], []
    for _ in range(options.repeat):
        copies.append(plain_copy(frames))
        runs.append(one_run(frames, patterns))
    matched = runs[0].matched
    share = matched / (CAMERA.width * CAMERA.height)
    one_piece_ms, frame_by_frame_ms = (
        1e3 * min(times_s) for times_s in zip(*((c.in_one_piece_s, c.frame_by_frame_s) for c in copies), strict=True)
    )
    title = (
        f"{CAMERA.width} × {CAMERA.height}, {len(frames)} frames, {matched:,} matches ({share:.0%}); "
        f"a plain copy: {one_piece_ms:.0f} ms, frame by frame {frame_by_frame_ms:.0f} ms"
    )
    Console(width=60 + 22 * len(runs)).print(table_of(runs, copies, title))
    if options.profile:
        profile = cProfile.Profile()
        one_run(frames, patterns, profile)
        pstats.Stats(profile).sort_stats("cumulative").print_stats(r"/(scanner|calib)/", options.profile)


if __name__ == "__main__":
    main()
