"""Errors over sigmas for decentred lenses: random rigs in front of corners.

    python benchmarks/bench_lenses.py --rigs 24 --seed 0
    python benchmarks/bench_lenses.py --told nothing
    python benchmarks/bench_lenses.py --random-rigs 1000

Synthetic matches of the paper's devices (300,000 a capture before what a wall hides, 0.1 px of noise, k1 −0.02 and
−0.01), no images. The projector stands 0.4 m beside the camera, toed in by 6 to 12°; both look into the corner, yawed
by up to 18°. p1 and p2 of both devices are drawn with the standard deviation that begins a row. The prior of the
calibration is that one (`--told true`), the same for all rows (`--told 0.0003`), or what is assumed of any lens
(`--told nothing`). 'error' is the mean absolute error of (f_c, f_p, x_p, y_p) relative to their size. An error/sigma of
rms 1 means that the sigma is true.

`--random-rigs` counts refusals of this many rigs in front of exactly square corners with 20,000 matches. A refusal for
walls that are not square means that the search ended in a wrong minimum.
"""

import argparse
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Intrinsics, Pose
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, self_calibrate_jointly
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, CaptureOptions, random_captures

SIZES = (PAPER_CAMERA.width, PAPER_CAMERA.height), (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
KNOWN = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)
UNKNOWN = PrincipalPoint(((SIZES[0][0] - 1) / 2, (SIZES[0][1] - 1) / 2), 70.0)
K1 = (-0.02, -0.01)
YAW_DEG, TOE_IN_DEG, BASELINE_M = 18.0, (6.0, 12.0), 0.4
_SIDEWAYS = float(np.cos(np.radians(45 + YAW_DEG))), float(np.cos(np.radians(45 - YAW_DEG)))
VIEWS = CaptureOptions(count=300_000, distance=(1.5, 3.5), slants=(_SIDEWAYS, _SIDEWAYS, (0.3, 0.7)), roll=0.03)


@dataclass(frozen=True)
class Row:
    decentering: float  # standard deviation of p1 and p2 of both devices
    point: PrincipalPoint = KNOWN
    captures: int = 1
    off_deg: float = 0.0
    squareness_deg: float | None = None  # prior on the walls; the truth if left out
    told: bool = True  # whether anything is said of the walls
    matches: int = VIEWS.count
    scaled: float = 1.0  # the projector's picture, along x

    @property
    def name(self) -> str:
        told = "" if self.told else " (not told)"
        walls = f", walls {self.off_deg:g}°{told}" if self.off_deg else ""
        scaled = f", picture {100 * (self.scaled - 1):+g} %" if self.scaled != 1 else ""
        return (
            f"{self.decentering:<7g} PP {'known' if self.point is KNOWN else 'unknown':8}{self.captures}{walls}{scaled}"
        )


DECENTERINGS = (0.0, 0.0002, 0.001, 0.002)
WALLS_DEG = (0.1, 0.3, 0.8)
ROWS = (
    *(Row(size, point) for size in DECENTERINGS for point in (KNOWN, UNKNOWN)),
    *(Row(size, UNKNOWN, captures) for captures in (2, 3) for size in DECENTERINGS),
    *(Row(size, KNOWN, captures, 0.3) for captures in (1, 2) for size in DECENTERINGS),
    *(Row(size, UNKNOWN, 3, 0.3) for size in DECENTERINGS),
    *(Row(0.0002, KNOWN, captures, off, told=False) for captures in (1, 2) for off in WALLS_DEG),
    *(Row(0.0002, UNKNOWN, captures, 0.3, scaled=1.01) for captures in (1, 2)),
)


@dataclass(frozen=True)
class Outcome:
    seconds: float
    refusal: str = ""
    error: np.ndarray | None = None  # (4,), relative
    deviation: np.ndarray | None = None  # (4,), in sigmas


def toed_in(rng: np.random.Generator, camera: Intrinsics, projector: Intrinsics) -> Calibration:
    """A projector to the left or right of the camera, converging."""
    side = rng.choice([-1.0, 1.0])
    turn = [rng.normal(0, 0.02), side * np.radians(rng.uniform(*TOE_IN_DEG)), rng.normal(0, 0.02)]
    rotation = Rotation.from_rotvec(turn).as_matrix()
    return Calibration(camera, projector, Pose(rotation, -rotation @ [side * BASELINE_M, 0.0, 0.0]), unit="m")


def outcome(row: Row, told: str, seed: int, number: int) -> Outcome:
    rng = np.random.default_rng([seed, number])
    terms = rng.normal(size=(2, 2)) * row.decentering
    camera, projector = (
        replace(device, distortion=(k1, 0.0, float(p1), float(p2), 0.0))
        for device, k1, (p1, p2) in zip((PAPER_CAMERA, PAPER_PROJECTOR), K1, terms, strict=True)
    )
    rig = toed_in(rng, camera, projector)
    squareness_deg = row.off_deg if row.squareness_deg is None else row.squareness_deg
    captures = random_captures(
        rng,
        row.captures,
        VIEWS,
        count=row.matches,
        camera=camera,
        projector=projector,
        walls_off_deg=row.off_deg,
        rig=rig,
    )
    middle = np.array([(SIZES[1][0] - 1) / 2, 0.0])
    matches = [
        replace(capture.matches, projector_px=(capture.matches.projector_px - middle) * (row.scaled, 1.0) + middle)
        for capture in captures
    ]
    start = time.process_time()
    try:
        found = self_calibrate_jointly(
            matches,
            *SIZES,
            principal_point=row.point,
            squareness_deg=squareness_deg if row.told else None,
            decentering=row.decentering if told == "true" else None if told == "nothing" else float(told),
        )[0].calibration
    except RefusalError as refusal:
        return Outcome(time.process_time() - start, str(refusal))
    seconds = time.process_time() - start
    sigma: Any = found.sigma
    truth = np.array([PAPER_CAMERA.focal_px[0], PAPER_PROJECTOR.focal_px[0], *PAPER_PROJECTOR.principal_point_px])
    values = [found.camera.focal_px[0], found.projector.focal_px[0], *found.projector.principal_point_px]
    sigmas = [sigma.camera.focal_px[0], sigma.projector.focal_px[0], *sigma.projector.principal_point_px]
    error = np.array(values) - truth
    return Outcome(seconds, "", error / truth, error / np.array(sigmas))


def line(row: Row, outcomes: list[Outcome]) -> str:
    errors = [each.error for each in outcomes if each.error is not None]
    deviations = np.array([each.deviation for each in outcomes if each.deviation is not None])
    text = f"{row.name:44}{len(errors):4d}/{len(outcomes):<4d}"
    if errors:
        means = 100 * np.mean(np.abs(errors), axis=1)
        text += f"{np.mean(means):8.3f} %{np.median(means):8.3f} %"
        text += f"{np.sqrt(np.mean(deviations**2)):8.2f} ({np.abs(deviations).max():.1f})"
    return f"{text:87}{np.median([each.seconds for each in outcomes]):6.2f} s"


def not_square(rigs: int, seed: int, pool: ProcessPoolExecutor) -> None:
    """Print how many rigs in front of square corners were refused and why, for each prior of the walls' angles."""
    for squareness_deg in (0.0, 0.3):
        row = Row(0.0003, squareness_deg=squareness_deg, matches=20_000)
        outcomes = list(pool.map(outcome, repeat(row), repeat("true"), repeat(seed), range(rigs)))
        reasons = Counter(each.refusal.split(":")[0].split(",")[0] for each in outcomes if each.refusal)
        wrong = [number for number, each in enumerate(outcomes) if "not square" in each.refusal]
        print(f"squareness_deg {squareness_deg:g}: {len(wrong)} of {rigs} refused as not square {wrong or ''}")
        for reason, count in reasons.most_common():
            print(f"    {count}: {reason}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--told", default="true", help="the prior's sigma of p1 and p2, 'true' or 'nothing'")
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--refusals", action="store_true", help="say why rigs were refused")
    parser.add_argument("--random-rigs", type=int, default=0, help="look for square corners refused as not square")
    parser.add_argument("--processes", type=int, default=None, help="all processors by default")
    options = parser.parse_args()
    if options.random_rigs:
        with ProcessPoolExecutor(options.processes) as pool:
            not_square(options.random_rigs, options.seed, pool)
        return
    print(f"{'p1, p2':15}{'captures':29}answered   mean     median   error/sigma (largest)   CPU time")
    with ProcessPoolExecutor(options.processes) as pool:
        for row in ROWS:
            if options.only not in row.name:
                continue
            outcomes = list(
                pool.map(outcome, repeat(row), repeat(options.told), repeat(options.seed), range(options.rigs))
            )
            print(line(row, outcomes), flush=True)
            if options.refusals:
                for number, each in enumerate(outcomes):
                    print(f"    {number}: {each.refusal}" if each.refusal else "", end="\n" if each.refusal else "")


if __name__ == "__main__":
    main()
