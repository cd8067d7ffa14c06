"""What it costs that frames are on the disk itself: time per frame with and without waiting for it.

python benchmarks/bench_recording.py --out some/folder/on/the/disk
"""

import shutil
import time
from argparse import ArgumentParser
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np

from calib.geometry import Size
from hw.rig import Frame
from scanner.capture import Stream, record
from scanner.capture import recorder as recorder_module
from scanner.patterns import PRESETS, Pattern

SIZES = (Size(612, 512), Size(2448, 2048))
EXPOSURES_S = (1 / 60, 1 / 30, 1 / 10)


def frames(patterns: tuple[Pattern, ...], size: Size, exposure_s: float) -> Iterator[tuple[Pattern, Frame]]:
    """Of a camera whose noise does not compress."""
    image = np.random.default_rng(0).normal(120, 3, size[::-1]).clip(0, 255).astype(np.uint8)
    for pattern in patterns:
        time.sleep(exposure_s)
        yield pattern, Frame(image)


def ms_per_frame(folder: Path, size: Size, exposure_s: float) -> float:
    """Of a capture that is recorded and not decoded."""
    patterns = PRESETS["standard"].patterns((854, 480))
    stream = Stream(patterns, Size(854, 480), size, frames(patterns, size, exposure_s))
    begin_s = time.monotonic()
    for _ in record(stream, folder).frames:
        pass
    elapsed_s = time.monotonic() - begin_s
    shutil.rmtree(folder)
    return 1e3 * elapsed_s / len(patterns)


def main() -> None:
    """Print a row for each camera and exposure."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("bench-recording"), help="folder to make and to remove")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    print("camera        exposure, ms  per frame, ms: not synced  synced")
    for size in SIZES:
        for exposure_s in EXPOSURES_S:
            without, with_sync = [], []
            for _ in range(args.rounds):
                with patch.object(recorder_module, "sync_open", lambda _: None):
                    without.append(ms_per_frame(args.out, size, exposure_s))
                with_sync.append(ms_per_frame(args.out, size, exposure_s))
            print(f"{size!s:<14}{1e3 * exposure_s:>12.1f}{min(without):>27.1f}{min(with_sync):>8.1f}")


if __name__ == "__main__":
    main()
