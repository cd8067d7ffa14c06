"""How long the decoder takes, next to a plain copy of the same frames in the same run.

python benchmarks/bench_decode.py [--width 2448 --height 2048] [--projector 1920x1080] [--repeat 3]
"""

import argparse
import statistics
import time
import tracemalloc
from collections.abc import Callable

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from calib.arrays import Image
from scanner.decode import Decoder
from scanner.patterns import Pattern, draw, sequence_for

_INDIRECT = 0.1
_WHITE = 180.0
_AMBIENT = 10.0


def render(patterns: tuple[Pattern, ...], projector: tuple[int, int], size: tuple[int, int]) -> list[Image]:
    """Frames (H, W) of a wavy, textured wall with a shadow, with noise."""
    width, height = size
    rng = np.random.default_rng(1)
    u, v = np.meshgrid(np.linspace(0, 1, width, dtype=np.float32), np.linspace(0, 1, height, dtype=np.float32))
    x = projector[0] * (0.05 + 0.9 * u + 0.01 * np.sin(7 * v)) - 0.5
    y = projector[1] * (0.05 + 0.9 * v + 0.01 * np.sin(9 * u)) - 0.5
    albedo = 0.7 + 0.2 * np.sin(40 * u) * np.cos(30 * v)
    albedo[(np.abs(u - 0.6) < 0.1) & (np.abs(v - 0.5) < 0.2)] = 0
    noise = [rng.normal(0, 1.2, (height, width)).astype(np.float32) for _ in range(3)]
    frames: list[Image] = []
    for number, pattern in enumerate(patterns):
        shown = cv2.GaussianBlur((draw(pattern, projector) / np.float32(255)) ** np.float32(2.2), (0, 0), 0.6)
        seen = albedo * (cv2.remap(shown, x, y, cv2.INTER_LINEAR) + _INDIRECT * shown.mean())
        levels = _WHITE * seen + _AMBIENT + np.roll(noise[number % 3], 7919 * number)
        frames.append(np.clip(np.rint(levels), 0, 255).astype(np.uint8))
    return frames


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


def peak_memory_mb(patterns: tuple[Pattern, ...], projector: tuple[int, int], frames: list[Image]) -> float:
    """Of the arrays of a run of its own, above the frames; the matches are most of it."""
    tracemalloc.start()
    decode(patterns, projector, frames)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


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
        f"{peak_memory_mb(patterns, projector, frames):.0f}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=2448, help="of the camera, pixels")
    parser.add_argument("--height", type=int, default=2048, help="of the camera, pixels")
    parser.add_argument("--projector", default="1920x1080", help="WIDTHxHEIGHT in pixels")
    parser.add_argument("--repeat", type=int, default=3, help="runs of which the median is shown")
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
        "peak memory, MB",
    ):
        table.add_column(column, justify="right")
    for scale in (0.5, 1.0):
        size = round(arguments.width * scale), round(arguments.height * scale)
        table.add_row(*measure(size, (width, height), arguments.repeat))
    Console().print(table)


if __name__ == "__main__":
    main()
