"""Time, memory and files of a projection mapping, by the number of projectors.

    OPENBLAS_NUM_THREADS=1 python benchmarks/bench_mapping.py [--size 3840 2160]

The projectors are those of `tests/support/mapped_room.py` with more pixels, side by side before one wall.
`scan export` runs in a process of its own: 'memory' is the most that it had at once, 'processors' its time on all of
them.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.support.mapped_room import write_projectors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, nargs=2, default=(3840, 2160), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--projectors", type=int, nargs="+", default=[1, 2, 4])
    options = parser.parse_args()
    print(f"{'projectors':>10} {'seconds':>8} {'processors':>11} {'memory':>8} {'files':>8}")
    for count in options.projectors:
        with tempfile.TemporaryDirectory() as scratch:
            folder, out = Path(scratch) / "hall", Path(scratch) / "mapping"
            write_projectors(folder, count, tuple(options.size))
            start = time.perf_counter()
            command = ("export", folder, "--to", "mapping", "--out", out, "--quiet")
            process = subprocess.Popen([sys.executable, "-m", "scanner", *map(str, command)])
            _, status, used = os.wait4(process.pid, 0)
            seconds = time.perf_counter() - start
            if status != 0:
                sys.exit(f"scan export failed with {count} projectors")
            written = sum(path.stat().st_size for path in out.iterdir())
            print(
                f"{count:10d} {seconds:6.1f} s {used.ru_utime + used.ru_stime:9.1f} s {used.ru_maxrss / 1e6:5.2f} GB "
                f"{written / 1e9:5.2f} GB",
                flush=True,
            )


if __name__ == "__main__":
    main()
