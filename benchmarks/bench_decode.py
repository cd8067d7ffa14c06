"""Time of decoding, relative to a plain copy of the same frames in the same run, and to its limit.

    python benchmarks/bench_decode.py [--width 2448 --height 2048] [--projector 1920x1080] [--repeat 5]

At half the size and at the full one. An untimed run loads the machine code, or compiles it. The second table shows
where the time after the last frame goes.

With `--peer-python`, the interpreter of an environment that has opencv-contrib-python-headless and fringes, OpenCV's
structured_light and the package Fringes decode frames of the same scene as well (see peer_decoders.py).
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as every command does, before NumPy is imported

import argparse
import cProfile
import json
import subprocess
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table
from stopwatch import PlainCopy, plain_copy

from calib.numerics import Image
from scanner.decoding import Decoder, Floats32
from scanner.patterns import Axis, Pattern, draw, gray_sequence, phase_sequence, sequence_for

_INDIRECT = 0.1
_WHITE = 180.0
_AMBIENT = 10.0
_BYTES_PER_MATCH = 20
_PERIODS, _SHIFTS = (21.0, 19.0), 4
# Limits of decoding; growth is that of the time per pixel, from half the size to the full one.
_MOST_PER_FRAME_MS, _MOST_FOLDING, _MOST_COPIES, _MOST_GROWTH, _MOST_MEMORY_MB = 4, 6, 8, 1, 300
_AXES: tuple[Axis, ...] = ("x", "y")
# Functions of each stage after the last frame. Tolerances are measured together with the checks.
_STAGES = {
    "noise": ("measure_noise",),
    "checks, tolerances": ("check_frames", "check_codes", "check_fringes", "check_maps"),
    "footprint": ("_footprint",),
    "maps of all pixels": ("decode_tiles",),
    "patches": ("small_patches",),
    "matches": ("_pixel_matches",),
}


def render(patterns: tuple[Pattern, ...], projector: tuple[int, int], size: tuple[int, int]) -> list[Image]:
    """Frames (H, W) of a wavy, textured wall with a shadow, with noise."""
    width, height = size
    u, v = np.meshgrid(np.linspace(0, 1, width, dtype=np.float32), np.linspace(0, 1, height, dtype=np.float32))
    x = projector[0] * (0.05 + 0.9 * u + 0.01 * np.sin(7 * v)) - 0.5
    y = projector[1] * (0.05 + 0.9 * v + 0.01 * np.sin(9 * u)) - 0.5
    albedo: Floats32 = (0.7 + 0.2 * np.sin(40 * u) * np.cos(30 * v)).astype(np.float32)
    albedo[(np.abs(u - 0.6) < 0.1) & (np.abs(v - 0.5) < 0.2)] = 0
    return [*seen_by_camera(patterns, projector, np.stack([x, y], axis=-1), albedo)]


def seen_by_camera(
    patterns: tuple[Pattern, ...], projector: tuple[int, int], projector_px: Floats32, albedo: Floats32
) -> Iterator[Image]:
    """Frames (H, W), given the projector pixel (H, W, 2) and the albedo (H, W) of each camera pixel."""
    rng = np.random.default_rng(1)
    x, y = cv2.split(projector_px)
    noise = [rng.normal(0, 1.2, albedo.shape).astype(np.float32) for _ in range(3)]
    for number, pattern in enumerate(patterns):
        shown = cv2.GaussianBlur((draw(pattern, projector) / np.float32(255)) ** np.float32(2.2), (0, 0), 0.6)
        seen = albedo * (cv2.remap(shown, x, y, cv2.INTER_LINEAR) + _INDIRECT * shown.mean())
        levels = _WHITE * seen + _AMBIENT + np.roll(noise[number % 3], 7919 * number)
        yield np.clip(np.rint(levels), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Run:
    """Seconds for each frame, seconds for the end, and the number of matches."""

    frames_s: tuple[float, ...]
    end_s: float
    matches: int

    @property
    def seconds(self) -> float:
        return sum(self.frames_s) + self.end_s


@dataclass(frozen=True)
class Measured:
    """The minimum of several runs, in seconds, for a camera of `size` (width, height); memory in bytes; `stages`: the
    share of each in the time after the last frame.
    """

    size: tuple[int, int]
    frames: int
    copy: PlainCopy
    frame_s: float
    slowest_frame_s: float
    end_s: float
    all_s: float
    matches: int
    peak_bytes: int
    stages: dict[str, float]

    @property
    def pixels(self) -> int:
        return self.size[0] * self.size[1]

    @property
    def folding_copies(self) -> float:
        """Time of accumulating all frames, in plain copies of them."""
        return self.frames * self.frame_s / self.copy.in_one_piece_s

    @property
    def copies(self) -> float:
        """Total time, in plain copies."""
        return self.all_s / self.copy.in_one_piece_s

    @property
    def copies_frame_by_frame(self) -> float:
        """Total time, in copies made frame by frame."""
        return self.all_s / self.copy.frame_by_frame_s

    def growth_from(self, smaller: "Measured") -> float:
        """Ratio of the time per pixel to that of another run."""
        return (self.all_s / self.pixels) / (smaller.all_s / smaller.pixels)


def timed(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def folded(patterns: tuple[Pattern, ...], projector: tuple[int, int], frames: list[Image]) -> Decoder:
    decoder = Decoder(patterns, projector)
    for frame in frames:
        decoder.add(frame)
    return decoder


def decode(patterns: tuple[Pattern, ...], projector: tuple[int, int], frames: list[Image]) -> Run:
    decoder = Decoder(patterns, projector)
    frames_s = tuple(timed(partial(decoder.add, frame)) for frame in frames)
    start = time.perf_counter()
    matches = decoder.finish().matches
    return Run(frames_s, time.perf_counter() - start, len(matches))


def peak_memory(patterns: tuple[Pattern, ...], projector: tuple[int, int], frames: list[Image]) -> int:
    """Peak bytes of the arrays of a separate run, without the frames, which the decoder keeps."""
    tracemalloc.start()
    decode(patterns, projector, frames)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak - sum(frame.nbytes for frame in frames)


def stages_of_end(decoder: Decoder) -> dict[str, float]:
    """The share of each stage in the time after the last frame."""
    profile = cProfile.Profile()
    total = timed(lambda: profile.runcall(decoder.finish))
    seconds = {entry.code.co_name: entry.totaltime for entry in profile.getstats() if not isinstance(entry.code, str)}
    # The footprint is measured while the maps are made.
    seconds["decode_tiles"] -= seconds["_footprint"]
    shares = {stage: sum(seconds[name] for name in names) / total for stage, names in _STAGES.items()}
    return shares | {"the rest": 1 - sum(shares.values())}


def measure(size: tuple[int, int], projector: tuple[int, int], repeat: int) -> Measured:
    patterns = sequence_for(projector)
    frames = render(patterns, projector, size)
    decode(patterns, projector, frames)
    before = plain_copy(frames)
    runs = [decode(patterns, projector, frames) for _ in range(repeat)]
    return Measured(
        size,
        len(frames),
        copy=min(before, plain_copy(frames), key=lambda copy: copy.in_one_piece_s),
        frame_s=min(sum(run.frames_s) for run in runs) / len(frames),
        slowest_frame_s=min(max(run.frames_s) for run in runs),
        end_s=min(run.end_s for run in runs),
        all_s=min(run.seconds for run in runs),
        matches=runs[0].matches,
        peak_bytes=peak_memory(patterns, projector, frames),
        stages=stages_of_end(folded(patterns, projector, frames)),
    )


def figures(measured: list[Measured], projector: tuple[int, int]) -> Table:
    table = Table(title="Decoding the standard sequence of a {} × {} projector".format(*projector))
    columns = (
        "camera",
        "copy (frame by frame), ms",
        "per frame (slowest), ms",
        "end, ms",
        "folding / copy",
        "all / copy (frame by frame)",
    )
    for column in (*columns, "per pixel, ns", "growth", "matched", "peak memory (matches), MB"):
        table.add_column(column, justify="right")
    smallest, largest = measured[0], measured[-1]
    for one in measured:
        table.add_row(
            "{} × {}".format(*one.size),
            f"{1e3 * one.copy.in_one_piece_s:.0f} ({1e3 * one.copy.frame_by_frame_s:.0f})",
            f"{1e3 * one.frame_s:.1f} ({1e3 * one.slowest_frame_s:.1f})",
            f"{1e3 * one.end_s:.0f}",
            f"{one.folding_copies:.1f}",
            f"{one.copies:.1f} ({one.copies_frame_by_frame:.1f})",
            f"{1e9 * one.all_s / one.pixels:.0f}",
            "" if one is smallest else f"{one.growth_from(smallest):.2f}",
            f"{one.matches / one.pixels:.0%}",
            f"{one.peak_bytes / 1e6:.0f} ({one.matches * _BYTES_PER_MATCH / 1e6:.0f})",
        )
    limits = (_MOST_PER_FRAME_MS, _MOST_FOLDING, _MOST_COPIES, _MOST_GROWTH, _MOST_MEMORY_MB)
    found = (
        1e3 * largest.slowest_frame_s,
        largest.folding_copies,
        largest.copies,
        largest.growth_from(smallest),
        largest.peak_bytes / 1e6,
    )
    table.add_section()
    for name, cells in (
        ("limit", [f"≤ {limit}" for limit in limits]),
        ("of limit", [f"{value / limit:.2f}" for value, limit in zip(found, limits, strict=True)]),
    ):
        per_frame, folding, copies, growth, memory = cells
        table.add_row(name, "", per_frame, "", folding, copies, "", growth, "", memory)
    return table


def stages(measured: list[Measured]) -> Table:
    table = Table(title="Where the time after the last frame goes")
    for column in ("camera", *measured[0].stages):
        table.add_column(column, justify="right")
    for one in measured:
        table.add_row("{} × {}".format(*one.size), *(f"{share:.0%}" for share in one.stages.values()))
    return table


def peers(python: str, size: tuple[int, int], projector: tuple[int, int], console: Console) -> None:
    """The peers' patterns, rendered once; each decodes its own, and so does this decoder."""
    gray = tuple(p for axis, length in zip(_AXES, projector, strict=True) for p in gray_sequence(axis, length, 1))
    waves = tuple(p for axis in _AXES for period in _PERIODS for p in phase_sequence(axis, period, _SHIFTS))
    codes = tuple(p for axis, length in zip(_AXES, projector, strict=True) for p in gray_sequence(axis, length, 8))
    gray_frames, wave_frames, code_frames = (render(part, projector, size) for part in (gray, waves, codes))
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "gray.npy", np.stack(gray_frames))
        np.save(Path(folder) / "fringes.npy", np.stack(wave_frames))
        job = {"folder": folder, "projector": projector, "periods": _PERIODS, "shifts": _SHIFTS}
        command = [python, str(Path(__file__).with_name("peer_decoders.py"))]
        done = subprocess.run(command, input=json.dumps(job), capture_output=True, text=True, check=False)
    if done.returncode:
        console.print(f"{python} could not run the peers: {done.stderr.strip().splitlines()[-1]}")
        return
    seconds = json.loads(done.stdout)
    table = Table(title="The same frames by other decoders")
    for column in ("decoder", "frames", "s", "this one, s", "times as long"):
        table.add_column(column, justify="right")
    cases: tuple[tuple[str, tuple[Pattern, ...], list[Image]], ...] = (
        ("opencv", gray, gray_frames),
        ("fringes", (*codes, *waves), [*code_frames, *wave_frames]),
    )
    for name, patterns, frames in cases:
        if name in seconds:
            own = decode(patterns, projector, frames).seconds
            shown = len(gray_frames) if name == "opencv" else len(wave_frames)
            table.add_row(name, str(shown), f"{seconds[name]:.1f}", f"{own:.2f}", f"{seconds[name] / own:.0f}")
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=2448, help="of the camera, pixels")
    parser.add_argument("--height", type=int, default=2048, help="of the camera, pixels")
    parser.add_argument("--projector", default="1920x1080", help="WIDTHxHEIGHT in pixels")
    parser.add_argument("--repeat", type=int, default=5, help="runs of which the quickest is shown")
    parser.add_argument("--peer-python", help="interpreter with opencv-contrib and fringes; without it no comparison")
    arguments = parser.parse_args()
    width, height = (int(number) for number in arguments.projector.split("x"))

    sizes = [(round(arguments.width * scale), round(arguments.height * scale)) for scale in (0.5, 1.0)]
    measured = [measure(size, (width, height), arguments.repeat) for size in sizes]
    console = Console(width=120)
    console.print(figures(measured, (width, height)))
    console.print(stages(measured))
    if arguments.peer_python:
        peers(arguments.peer_python, (arguments.width, arguments.height), (width, height), console)
    else:
        console.print("Other decoders are compared with --peer-python; see peer_decoders.py.")


if __name__ == "__main__":
    main()
