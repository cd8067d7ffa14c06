"""Whether recording and decoding keep up with the camera.

    python benchmarks/bench_recording.py --out some/folder/on/the/disk [--rounds 3]

A simulated camera exposes and transfers frames, which are prefetched, recorded (on the disk itself, or in its cache
only) and decoded as in a scan. "of limit" is the ratio to the limit, 10 % over exposure and transfer. The second table
compares file formats that OpenCV reads, in milliseconds of work per frame (two processors share that of a PNG).
"""

import shutil
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from unittest.mock import patch

import cv2
import numpy as np
from bench_decode import render
from rich.console import Console
from rich.table import Table

from calib.geometry import Size
from calib.numerics import Image
from hw.ahead import Ahead, in_background
from hw.rig import Frame
from hw.timing import MOST_AHEAD
from scanner.capture import Stream, record
from scanner.capture import recorder as recorder_module
from scanner.decoding import Decoder
from scanner.io import png_of, sync_open
from scanner.patterns import PRESETS, Pattern

PROJECTOR = Size(854, 480)
PATTERNS = PRESETS["standard"].patterns(PROJECTOR)
LIMIT = 1.1  # of exposure and transfer
# Pixels, exposure, and transfer at about 110 (GigE Vision) or 380 MB/s (USB3 Vision).
CAMERAS = [
    (Size(612, 512), 1 / 30, 0.003),
    (Size(2448, 2048), 1 / 30, 0.045),
    (Size(2448, 2048), 1 / 30, 0.013),
    (Size(2448, 2048), 1 / 60, 0.013),
]


def encoder(suffix: str, *options: int) -> Callable[[Image], bytes]:
    """An encoder of OpenCV."""
    return lambda image: cv2.imencode(suffix, image, options)[1].tobytes()


_RUNS_ONLY = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
WAYS: dict[str, Callable[[Image], bytes]] = {
    "PNG as recorded": png_of,
    "PNG, one filter, runs only": encoder(".png", *_RUNS_ONLY, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB),
    "PNG level 1": encoder(".png", cv2.IMWRITE_PNG_COMPRESSION, 1),
    "PNG level 0": encoder(".png", cv2.IMWRITE_PNG_COMPRESSION, 0),
    "TIFF, LZW": encoder(".tiff", cv2.IMWRITE_TIFF_COMPRESSION, 5),
    "TIFF, deflate": encoder(".tiff", cv2.IMWRITE_TIFF_COMPRESSION, 8),
    "TIFF, raw": encoder(".tiff", cv2.IMWRITE_TIFF_COMPRESSION, 1),
    "PGM, raw": encoder(".pgm"),
}


def exposed(images: list[Image], period_s: float) -> Iterator[tuple[Pattern, Frame]]:
    """Frames of a camera that does not wait for the consumer."""
    due_s = time.monotonic()
    for pattern, image in zip(PATTERNS, images, strict=True):
        due_s = max(due_s, time.monotonic() - period_s) + period_s
        time.sleep(max(0.0, due_s - time.monotonic()))
        yield pattern, Frame(image)


def capture(folder: Path, images: list[Image], size: Size, period_s: float) -> tuple[float, float]:
    """Seconds per frame of a recorded and decoded capture, and the total time that the camera waited."""
    ahead = Ahead(exposed(images, period_s), MOST_AHEAD)
    stream = record(Stream(PATTERNS, PROJECTOR, size, iter(ahead)), folder)
    decoder = Decoder(PATTERNS, PROJECTOR)
    begin_s = time.monotonic()
    with in_background(decoder.add) as add:
        for _, frame in stream.frames:
            add(frame.image)
    elapsed_s = time.monotonic() - begin_s
    shutil.rmtree(folder)
    return elapsed_s / len(PATTERNS), ahead.waited_s


def captures(out: Path, rounds: int) -> Table:
    columns = (
        "camera",
        "exposure + transfer, ms",
        "synced",
        "per frame, ms",
        "of exposure + transfer",
        "of limit",
        "waited, s",
    )
    table = Table(*columns, title=f"{len(PATTERNS)} frames, recorded and decoded during the capture")
    images_of = {size: render(PATTERNS, PROJECTOR, size) for size, _, _ in CAMERAS}
    capture(out, images_of[CAMERAS[0][0]], CAMERAS[0][0], 0.1)  # loads compiled code
    for size, exposure_s, transfer_s in CAMERAS:
        period_s = exposure_s + transfer_s
        for synced in (False, True):
            each = []
            for _ in range(rounds):
                with patch.object(recorder_module, "sync_open", sync_open if synced else lambda _: None):
                    each.append(capture(out, images_of[size], size, period_s))
            seconds, waited_s = median(one for one, _ in each), median(one for _, one in each)
            ratio = seconds / period_s
            row = (str(size), f"{1e3 * period_s:.1f}", "yes" if synced else "no", f"{1e3 * seconds:.1f}")
            table.add_row(*row, f"{ratio:.2f}", f"{ratio / LIMIT:.2f}", f"{waited_s:.2f}")
    return table


def worked_ms(work: Callable[[], object]) -> float:
    """Processor time in ms, the least of three runs."""
    worked = []
    for _ in range(3):
        begin_s = time.process_time()
        work()
        worked.append(1e3 * (time.process_time() - begin_s))
    return min(worked)


def ways() -> Table:
    cv2.setNumThreads(1)
    frame = render(PATTERNS, PROJECTOR, Size(2448, 2048))[len(PATTERNS) // 2]
    deep = (frame.astype(np.uint16) << 8 | (frame[::-1] & 0x7F)).astype(np.uint16)
    table = Table("as", "8 bits: write", "read", "of raw", "16 bits: write", "read", "of raw", title="2448 × 2048")
    for name, encode in WAYS.items():
        cells = []
        for image in (frame, deep):
            data = np.frombuffer(encode(image), np.uint8)
            cells += [
                f"{worked_ms(partial(encode, image)):.1f}",
                f"{worked_ms(partial(cv2.imdecode, data, cv2.IMREAD_UNCHANGED)):.1f}",
                f"{data.nbytes / image.nbytes:.2f}",
            ]
        table.add_row(name, *cells)
    return table


def main() -> None:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("bench-recording"), help="folder to make and to remove")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    console = Console(width=120)
    console.print(captures(args.out, args.rounds))
    console.print(ways())


if __name__ == "__main__":
    main()
