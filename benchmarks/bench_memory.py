"""Memory: of a scan at 5 and 20 megapixels, of a room of twelve stations, and of an hour of live clouds.

    python benchmarks/bench_memory.py [--megapixels 5 20] [--stations 3 6 12] [--clouds 600]

Peaks are of a process of its own, the largest memory in use. *Scans*: corners that fill the picture, in fringes and in
Gray code alone, recorded, decoded, calibrated and saved while their frames come, as fast as they can be read. *Rooms*:
`scan room` from matches of a furnished room, one of each camera pixel. *Live*: one cloud after another of 1.3
megapixels, faster than a camera takes their frames; a line through the memory in use of the second half of them is told
for an hour at full rate, 18,000 clouds, with its standard error.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import cycle, islice
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Semaphore
from typing import TypeVar

import numpy as np
from bench_live import prepared
from bench_replay import write_corner
from rich.console import Console
from rich.table import Table

from scanner.acquisition import decode
from scanner.capture import open_capture, record
from scanner.configuration import load_config
from scanner.io import write_matches
from scanner.live import FRAMES, Account, LiveCloud, Round, take_rounds, watch
from scanner.reconstruction import reconstruct
from scanner.ui import SILENT

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.live_bench import LiveBench, calibration
from tests.support.whole_room import CAMERA, PROJECTOR, stations

_EXPOSURE_S = 1 / 30
_PER_HOUR = 3600 / (FRAMES * _EXPOSURE_S)
_SMALLER = 0.125  # than the camera of the live bench: 1.3 megapixels
_SEED = 1
Made = TypeVar("Made")


def alone(make: Callable[..., Made], *arguments: object, **named: object) -> Made:
    """What a function returns in a process of its own: a child's peak includes that of what it was forked from."""
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        return process.submit(make, *arguments, **named).result()


def in_use_bytes() -> float:
    """Memory in use of this process."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * float(os.sysconf("SC_PAGE_SIZE"))


def peak_bytes(command: Sequence[str]) -> float:
    """Largest memory in use of a command. Raises CalledProcessError if it fails."""
    process = subprocess.Popen(command)
    _, status, usage = os.wait4(process.pid, 0)
    if code := os.waitstatus_to_exitcode(status):
        raise subprocess.CalledProcessError(code, command)
    return 1024.0 * usage.ru_maxrss


def scanned(capture: Path, out: Path) -> float:
    """The largest memory in use of a scan with a camera whose frames are those of a recording."""
    config = load_config(capture.with_name("rig.yaml"))
    out.mkdir()
    (decoded,) = decode([record(open_capture(capture).stream(), out / "capture")], SILENT, "Capturing and decoding")
    reconstruct([decoded], config, out, SILENT)
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def scans(sizes: Sequence[float], console: Console) -> None:
    """Print a table of scans by the camera's size."""
    table = Table("megapixels", "sequence", "frames", "peak", "bytes a pixel", title="Scans")
    for megapixels in sizes:
        for fringes in (True, False):
            with TemporaryDirectory(prefix="memory-") as place:
                capture = alone(write_corner, Path(place) / "capture", megapixels, fringes=fringes)
                peak = alone(scanned, capture, Path(place) / "result")
                frames = len(open_capture(capture).files)
            sequence, per_pixel = "fringes" if fringes else "Gray code", peak / (1e6 * megapixels)
            table.add_row(f"{megapixels:g}", sequence, str(frames), f"{peak / 1e9:.2f} GB", f"{per_pixel:.0f}")
    console.print(table)


def write_stations(folder: Path, number: int) -> list[Path]:
    """Matches files of so many stations of a room, and the configuration of their rig."""
    made = stations(number, _SEED, camera=CAMERA, furniture_askew_deg=4.0)
    files = [folder / f"station-{k}.npz" for k in range(number)]
    for file, station in zip(files, made, strict=True):
        write_matches(file, station.matches)
    config = {
        "camera": {"width": CAMERA[0], "height": CAMERA[1], "principal_point": {"prior": "centre", "sigma_px": 35}},
        "projector": {"width": PROJECTOR[0], "height": PROJECTOR[1]},
        "scale": {"baseline_m": made[0].calibration.baseline},
    }
    (folder / "rig.yaml").write_text(json.dumps(config), encoding="utf-8")
    return files


def rooms(numbers: Sequence[int], console: Console) -> None:
    """Print a table of rooms by the number of their stations."""
    title = "Rooms, cameras of {} × {}".format(*CAMERA)
    table = Table("stations", "peak", "bytes a camera pixel", title=title)
    for number in numbers:
        with TemporaryDirectory(prefix="memory-") as place:
            files = alone(write_stations, Path(place), number)
            command = [sys.executable, "-m", "scanner", "room", *map(str, files), "--quiet"]
            peak = peak_bytes([*command, "--config", f"{place}/rig.yaml", "--out", f"{place}/room"])
        table.add_row(str(number), f"{peak / 1e9:.2f} GB", f"{peak / (number * CAMERA[0] * CAMERA[1]):.0f}")
    console.print(table)


def watched(clouds: int) -> list[float]:
    """Memory in use after each cloud, in bytes."""
    bench = LiveBench(calibration=calibration(smaller=_SMALLER))
    seen, sequence, decoder = prepared(bench)
    still = [taken for taken in islice(take_rounds(bench.rig, sequence, seen.response), 3) if taken is not None]
    in_use, decoded = list[float](), Semaphore()

    def rounds() -> Generator[Round | None]:
        for number, taken in enumerate(islice(cycle(still), clouds)):
            decoded.acquire()  # rounds that come meanwhile would be left out
            yield Round(number, taken.frames, taken.grey.copy(), taken.came_s)

    def measure(_cloud: LiveCloud | None, _account: Account) -> None:
        in_use.append(in_use_bytes())
        decoded.release()

    watch(rounds(), decoder, measure, lambda: False, Account())
    return in_use


def live(clouds: int, console: Console) -> None:
    """Print how much memory an hour of live clouds takes."""
    in_use = alone(watched, clouds)
    half = np.array(in_use[len(in_use) // 2 :])
    number = np.arange(len(half))
    (slope, _), covariance = np.polyfit(number, half, 1, cov=True)
    growth, error = _PER_HOUR * slope / 1e6, _PER_HOUR * float(np.sqrt(covariance[0, 0])) / 1e6
    console.print(
        f"Live: {max(in_use) / 1e9:.2f} GB at most in {len(in_use)} clouds; between the first of their second half and "
        f"the last {(half[-1] - half[0]) / 1e6:+.1f} MB; by a line {growth:+.0f} ± {error:.0f} MB an hour."
    )


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--megapixels", type=float, nargs="*", default=[5.0, 20.0])
    parser.add_argument("--stations", type=int, nargs="*", default=[3, 6, 12])
    parser.add_argument("--clouds", type=int, default=600)
    options = parser.parse_args()
    console = Console()
    if options.megapixels:
        scans(options.megapixels, console)
    if options.stations:
        rooms(options.stations, console)
    if options.clouds:
        live(options.clouds, console)


if __name__ == "__main__":
    main()
