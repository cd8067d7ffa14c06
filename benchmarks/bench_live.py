"""Live clouds: rate, delay and errors, beside a plain decoder on the same frames.

    python benchmarks/bench_live.py [--clouds 40] [--exposure-ms 33.3] [--rooms 3]

*Speed*: a simulated camera that only exposes. The rate is relative to that of its frames; the delay is from the last
exposure to the cloud; work is processor time per cloud over the time of its six frames. Rate and delay need an idle
machine; work does not.

*Truth*: a static ball in front of a wall in closed form, one that moves at 10 mm/s, and simulated corners compared with
a full scan from the same pose. Errors over sigmas are 68th percentiles; "off" is half a short period and more.

The plain decoder has three steps and two frequencies in NumPy, after SLStudio (Wilm et al. 2014): the longer fringe
gives the order of the shorter, and lit pixels are kept.
"""

import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Generator
from itertools import cycle, islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

from calib.numerics import Floats, Image
from hw.open_rig import open_rig
from scanner.acquisition import take
from scanner.configuration import Config
from scanner.live import (
    FRAMES,
    Account,
    FirstLook,
    LiveCloud,
    LiveDecoder,
    LiveSequence,
    Round,
    best_sequence,
    look,
    proven,
    take_rounds,
    watch,
)
from scanner.ui import Terminal

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.live_bench import LiveBench, calibration

LEAST_RATE, MOST_DELAY_S = {1.3: 0.95, 5.2: 0.5}, 0.15
DEPTHS = (0.35, 0.7)
BALL_M_PER_S = 0.01
_LEAST_AMPLITUDE = 5.0  # grey levels; least amplitude of the plain decoder


def plain(grey: Image, sequence: LiveSequence) -> Floats:
    """Coordinates (H, W) of a round (6, H, W), NaN where it is dark."""
    turns = 2 / 3 * np.exp(-2j * np.pi * np.arange(3) / 3)
    long, short = (np.tensordot(turns, grey[first::2].astype(np.float32), 1) for first in (0, 1))
    coarse = sequence.long_px / (2 * np.pi) * np.angle(long)
    coarse += sequence.long_px * np.rint((sequence.middle - coarse) / sequence.long_px)
    fine = sequence.short_px / (2 * np.pi) * np.angle(short)
    fine += sequence.short_px * np.rint((coarse - fine) / sequence.short_px)
    return np.where(np.abs(short) > _LEAST_AMPLITUDE, fine, np.nan)


def prepared(bench: LiveBench) -> tuple[FirstLook, LiveSequence, LiveDecoder]:
    """Prepare the live sequence as the program does before the first cloud."""
    seen = look(bench.rig, Config())
    sequence = best_sequence(bench.rig, seen, bench.calibration, DEPTHS)
    return seen, sequence, LiveDecoder(sequence, seen, bench.calibration)


def speed(smaller: float, clouds: int, exposure_s: float) -> list[str]:
    """A row of the table: rate and delay of clouds."""
    bench = LiveBench(calibration=calibration(smaller=smaller))
    seen, sequence, decoder = prepared(bench)
    still = [each for each in islice(take_rounds(bench.rig, sequence, seen.response), 3) if each is not None]

    def exposed() -> Generator[Round | None]:
        begin_s = time.monotonic()
        for number, each in enumerate(islice(cycle(still), clouds)):
            due_s = begin_s + (number + 1) * FRAMES * exposure_s
            time.sleep(max(0.0, due_s - time.monotonic()))
            yield Round(number, each.frames, each.grey.copy(), due_s)

    decoder.cloud(still[1], decoder.cloud(still[0]))  # load the machine code
    account, began_s = Account(), time.process_time()
    watch(exposed(), decoder, lambda _, __: None, lambda: False, account)
    decoded = account.clouds + account.contradicting + 1
    work = (time.process_time() - began_s) / (decoded * FRAMES * exposure_s)
    plain_s = min(timed(lambda: plain(still[0].grey, sequence)) for _ in range(3))
    rate = account.clouds / (clouds - 1)  # the first round cannot be compared
    megapixels = round(bench.calibration.camera.width * bench.calibration.camera.height / 1e6, 1)
    limit = LEAST_RATE[megapixels]
    return [
        f"{megapixels} megapixels",
        f"{rate:.2f} (at least {limit})",
        f"{1000 * account.delay_s:.0f} ms (at most {1000 * MOST_DELAY_S:.0f})",
        f"{work:.2f}",
        f"{plain_s / (FRAMES * exposure_s):.2f}",
    ]


def timed(work: Callable[[], object]) -> float:
    """Processor seconds."""
    began_s = time.process_time()
    work()
    return time.process_time() - began_s


def judged(name: str, coordinate: Floats, sigma: Floats | None, true: Floats, sequence: LiveSequence) -> list[str]:
    """A row of the table: share of measured pixels, and their errors."""
    off = np.abs(coordinate - true)
    there = np.isfinite(off)
    in_sigmas = "" if sigma is None else f"{np.quantile(off[there] / sigma[there], 0.683):.2f}"
    wrong = np.mean(off[there] > sequence.short_px / 2)
    share = np.count_nonzero(there) / np.count_nonzero(np.isfinite(true))
    return [name, f"{share:.1%}", f"{np.quantile(off[there], 0.683):.3f} px", in_sigmas, f"{wrong:.2%}"]


def of_ball(speed_m: tuple[float, float, float], exposure_s: float, name: str) -> list[list[str]]:
    """Rows of the ball alone: this decoder and the plain one."""
    bench = LiveBench(speed_m=(speed_m[0] * exposure_s, speed_m[1] * exposure_s, speed_m[2] * exposure_s))
    seen, sequence, decoder = prepared(bench)
    before, earlier = bench.taken, list[LiveCloud]()
    for each in islice(take_rounds(bench.rig, sequence, seen.response), 3):
        cloud = None if each is None else proven(decoder, each, earlier)
    assert cloud is not None
    middle = before + FRAMES * cloud.taken.number + (FRAMES - 1) / 2
    true = np.where(bench.on_ball(middle), bench.truth(middle)[0][..., sequence.number], np.nan)
    return both(name, cloud, 0.0, true, sequence)


def both(name: str, cloud: LiveCloud, of_true: Floats | float, true: Floats, sequence: LiveSequence) -> list[list[str]]:
    """Rows of this decoder, and of the plain one on the same frames. `of_true`: standard deviation of the reference."""
    ours, sigma = cloud.coordinate.astype(np.float64), np.hypot(np.sqrt(cloud.variance), of_true)
    theirs = plain(cloud.taken.grey, sequence)
    return [judged(name, ours, sigma, true, sequence), judged("  plain", theirs, None, true, sequence)]


def of_corner(seed: int) -> list[list[str]]:
    """Rows of a simulated corner, compared with a full scan from the same pose."""
    config = Config.model_validate(
        {
            "rig": {"backend": "simulated", "seed": seed},
            "camera": {"width": 612, "height": 512},
            "projector": {"width": 854, "height": 480},
            "sequence": {"preset": "standard"},
        }
    )
    settings, sizes = config.required_rig, (config.camera_size, config.projector_size)
    with TemporaryDirectory() as folder:
        full = take(settings, config, Path(folder), Terminal(quiet=True), "full scan").matches
    with open_rig(settings, *sizes) as opened:
        assert opened.truth is not None
        seen = look(opened.rig, config)
        sequence = best_sequence(opened.rig, seen, opened.truth, None)
        decoder, earlier = LiveDecoder(sequence, seen, opened.truth), list[LiveCloud]()
        cloud = None
        for each in islice(take_rounds(opened.rig, sequence, seen.response), 4):
            cloud = cloud if each is None else proven(decoder, each, earlier) or cloud
    assert cloud is not None
    assert full.sigma_px is not None
    true, sigma = (np.full(cloud.reason.shape, np.nan) for _ in range(2))
    column, row = np.rint(full.camera_px).astype(np.int64).T
    true[row, column] = full.projector_px[:, sequence.number]
    sigma[row, column] = full.sigma_px
    return both(f"corner {seed}, full scan", cloud, sigma, true, sequence)


def main() -> None:
    """Print both tables."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--clouds", type=int, default=40)
    parser.add_argument("--exposure-ms", type=float, default=33.3)
    parser.add_argument("--rooms", type=int, default=3)
    options = parser.parse_args()
    exposure_s = options.exposure_ms / 1000
    table = Table("", "rate", "delay", "work", "work of the plain decoder")
    for smaller in (0.125, 0.0625):
        table.add_row(*speed(smaller, options.clouds, exposure_s))
    Console().print(table)
    table = Table("", "pixels", "error", "error/sigma", "off")
    rows = [
        *of_ball((0, 0, 0), exposure_s, "ball, still"),
        *of_ball((BALL_M_PER_S, 0, 0), exposure_s, "ball, 10 mm/s across"),
        *of_ball((0, 0, -BALL_M_PER_S), exposure_s, "ball, 10 mm/s nearer"),
    ]
    for seed in range(options.rooms):
        rows += of_corner(seed)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


if __name__ == "__main__":
    main()
