"""How long the decoder takes, next to a plain copy of the same frames in the same run.

    python benchmarks/bench_decode.py [--width 2448 --height 2048] [--projector 1920x1080] [--repeat 3]

With `--peer-python`, the interpreter of an environment that has opencv-contrib-python-headless and fringes, OpenCV's
structured_light and the package Fringes decode frames of the same scene as well (see peer_decoders.py).
"""

import argparse
import json
import statistics
import subprocess
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from calib.arrays import Image
from scanner.decode import Decoder
from scanner.decoding.arrays import Floats32
from scanner.patterns import Pattern, draw, gray_sequence, phase_sequence, sequence_for

_INDIRECT = 0.1
_WHITE = 180.0
_AMBIENT = 10.0
_BYTES_PER_MATCH = 20
_PERIODS, _SHIFTS = (21.0, 19.0), 4


def render(patterns: tuple[Pattern, ...], projector: tuple[int, int], size: tuple[int, int]) -> list[Image]:
    """Frames (H, W) of a wavy, textured wall with a shadow, with noise."""
    width, height = size
    u, v = np.meshgrid(np.linspace(0, 1, width, dtype=np.float32), np.linspace(0, 1, height, dtype=np.float32))
    x = projector[0] * (0.05 + 0.9 * u + 0.01 * np.sin(7 * v)) - 0.5
    y = projector[1] * (0.05 + 0.9 * v + 0.01 * np.sin(9 * u)) - 0.5
    albedo = 0.7 + 0.2 * np.sin(40 * u) * np.cos(30 * v)
    albedo[(np.abs(u - 0.6) < 0.1) & (np.abs(v - 0.5) < 0.2)] = 0
    return [*seen_by_camera(patterns, projector, np.stack([x, y], axis=-1), albedo)]


def seen_by_camera(
    patterns: tuple[Pattern, ...], projector: tuple[int, int], projector_px: Floats32, albedo: Floats32
) -> Iterator[Image]:
    """Frames (H, W), given which projector pixel (H, W, 2) each camera pixel sees, and how much it reflects (H, W)."""
    rng = np.random.default_rng(1)
    noise = [rng.normal(0, 1.2, albedo.shape).astype(np.float32) for _ in range(3)]
    for number, pattern in enumerate(patterns):
        shown = cv2.GaussianBlur((draw(pattern, projector) / np.float32(255)) ** np.float32(2.2), (0, 0), 0.6)
        seen = albedo * (cv2.remap(shown, projector_px, None, cv2.INTER_LINEAR) + _INDIRECT * shown.mean())
        levels = _WHITE * seen + _AMBIENT + np.roll(noise[number % 3], 7919 * number)
        yield np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def timed(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def decode(patterns: tuple[Pattern, ...], projector: tuple[int, int], frames: list[Image]) -> tuple[float, float, int]:
    """Seconds for all frames, seconds for the end, and the number of matches."""
    decoder = Decoder(patterns, projector)
    start = time.perf_counter()
    for frame in frames:
        decoder.add(frame)
    middle = time.perf_counter()
    matches = decoder.finish().matches
    return middle - start, time.perf_counter() - middle, len(matches)


def peak_memory_mb(patterns: tuple[Pattern, ...], projector: tuple[int, int], frames: list[Image]) -> str:
    """Of the arrays of a run of its own, above the frames, and how much of it are the matches that it returns."""
    tracemalloc.start()
    *_, count = decode(patterns, projector, frames)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return f"{peak / 1e6:.0f} ({count * _BYTES_PER_MATCH / 1e6:.0f})"


def measure(size: tuple[int, int], projector: tuple[int, int], repeat: int) -> tuple[str, ...]:
    patterns = sequence_for(projector)
    frames = render(patterns, projector, size)
    runs = [decode(patterns, projector, frames) for _ in range(repeat)]
    copying = statistics.median(timed(lambda: [frame.copy() for frame in frames]) for _ in range(repeat))
    adding = statistics.median(run[0] for run in runs)
    finishing = statistics.median(run[1] for run in runs)
    return (
        f"{size[0]} × {size[1]}",
        str(len(frames)),
        f"{1e3 * copying:.0f}",
        f"{1e3 * adding / len(frames):.1f}",
        f"{1e3 * finishing:.0f}",
        f"{(adding + finishing) / copying:.1f}",
        f"{runs[0][2] / (size[0] * size[1]):.0%}",
        peak_memory_mb(patterns, projector, frames),
    )


def peers(python: str, size: tuple[int, int], projector: tuple[int, int], console: Console) -> None:
    """The peers' patterns, rendered once; each decodes its own, and so does this decoder."""
    gray = tuple(p for axis, length in zip("xy", projector, strict=True) for p in gray_sequence(axis, length, 1))
    waves = tuple(p for axis in "xy" for period in _PERIODS for p in phase_sequence(axis, period, _SHIFTS))
    codes = tuple(p for axis, length in zip("xy", projector, strict=True) for p in gray_sequence(axis, length, 8))
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
    for name, patterns, frames in (
        ("opencv", gray, gray_frames),
        ("fringes", (*codes, *waves), [*code_frames, *wave_frames]),
    ):
        if name in seconds:
            own = sum(decode(patterns, projector, frames)[:2])
            shown = len(gray_frames) if name == "opencv" else len(wave_frames)
            table.add_row(name, str(shown), f"{seconds[name]:.1f}", f"{own:.2f}", f"{seconds[name] / own:.0f}")
    console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=2448, help="of the camera, pixels")
    parser.add_argument("--height", type=int, default=2048, help="of the camera, pixels")
    parser.add_argument("--projector", default="1920x1080", help="WIDTHxHEIGHT in pixels")
    parser.add_argument("--repeat", type=int, default=3, help="runs of which the median is shown")
    parser.add_argument("--peer-python", help="interpreter with opencv-contrib and fringes; without it no comparison")
    arguments = parser.parse_args()
    width, height = (int(number) for number in arguments.projector.split("x"))

    table = Table(title=f"Decoding the standard sequence of a {width} × {height} projector")
    for column in (
        "camera",
        "frames",
        "copy, ms",
        "per frame, ms",
        "end, ms",
        "all / copy",
        "matched",
        "peak memory (matches), MB",
    ):
        table.add_column(column, justify="right")
    for scale in (0.5, 1.0):
        size = round(arguments.width * scale), round(arguments.height * scale)
        table.add_row(*measure(size, (width, height), arguments.repeat))
    console = Console(width=120)
    console.print(table)
    if arguments.peer_python:
        peers(arguments.peer_python, (arguments.width, arguments.height), (width, height), console)
    else:
        console.print("Other decoders are compared with --peer-python; see peer_decoders.py.")


if __name__ == "__main__":
    main()
