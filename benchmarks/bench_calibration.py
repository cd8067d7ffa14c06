"""Calibration from random corners: errors, errors over sigmas, and sigmas over the Cramér–Rao bound.

    python benchmarks/bench_calibration.py --corners 200 --seed 0

Synthetic matches of the paper's rig (50,000 a capture, 0.1 px of noise), no images. 'error' is the mean absolute error
of (f_c, f_p, x_p, y_p) relative to their size. An error/sigma of rms 1 means that the sigma is true, a sigma/bound of 1
that no unbiased method can be better. The bound fixes lens terms that are zero in truth, and is not computed for
captures that share a corner. The line below is error/sigma, rms, of each of the rig's parameters.
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any

import numpy as np
from cramer_rao import bound
from rig_deviation import COLUMNS, deviations, rms_of_columns

from calib.refinement import Knowledge
from calib.refusal import RefusalError
from calib.self_calibration import Method, PrincipalPoint, SelfCalibration, self_calibrate, self_calibrate_jointly
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, SyntheticCapture, random_captures

CAMERA_SIZE = (PAPER_CAMERA.width, PAPER_CAMERA.height)
PROJECTOR_SIZE = (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
CENTRE = PrincipalPoint(((CAMERA_SIZE[0] - 1) / 2, (CAMERA_SIZE[1] - 1) / 2), 0.03 * CAMERA_SIZE[0])
KNOWN = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)
WEAK, STRONG, NONE = (-0.02, -0.01), (-0.06, -0.03), (0.0, 0.0)
# k1, k2 of camera and projector: the range of ordinary lenses, as in the simulated rig.
ORDINARY = ((-0.06, -0.005), (-0.01, 0.01)), ((-0.03, 0.01), (-0.01, 0.01))
NOISE_PX = 0.1


@dataclass(frozen=True)
class Case:
    name: str
    k1: tuple[float, float] | None = WEAK  # None: k1 and k2 of random ordinary lenses
    point: PrincipalPoint = KNOWN
    off_deg: float = 0.0
    captures: int = 1
    same: bool = True
    method: Method = "refined"
    tangential: float = 0.0  # standard deviation of p1 and p2 of both devices


CASES = (
    Case("paper's method, no lens terms", NONE, method="paper"),
    Case("paper's method", method="paper"),
    Case("square, PP known", WEAK),
    Case("square, PP known, no lens terms", NONE),
    Case("square, PP known, ordinary lenses", None),
    Case("square, PP unknown, ordinary lenses", None, CENTRE),
    Case("square, PP unknown, strong lens", STRONG, CENTRE),
    Case("2 different square, PP unknown", WEAK, CENTRE, captures=2, same=False),
    Case("2 different square, no lens terms", NONE, CENTRE, captures=2, same=False),
    Case("walls 0.3°, PP known", WEAK, off_deg=0.3),
    Case("walls 0.3°, 2 of one corner, PP known", WEAK, off_deg=0.3, captures=2),
    Case("walls 0.3°, 3 of one corner, PP unknown", WEAK, CENTRE, 0.3, 3),
    Case("walls 0.3°, 4 of one corner, PP unknown", WEAK, CENTRE, 0.3, 4),
    Case("tangential, square, PP known", tangential=4e-4),
    Case("tangential, walls 0.3°, PP known", off_deg=0.3, tangential=4e-4),
    Case("tangential, 0.3°, 3 of one, PP unknown", WEAK, CENTRE, 0.3, 3, tangential=4e-4),
)


@dataclass(frozen=True)
class Outcome:
    seconds: float
    error: np.ndarray | None = None
    deviation: np.ndarray | None = None
    of_columns: np.ndarray | None = None
    over_bound: np.ndarray | None = None
    point_error_px: float = np.nan


def calibrated(case: Case, captures: list[SyntheticCapture]) -> SelfCalibration:
    matches = [capture.matches for capture in captures]
    sizes = (CAMERA_SIZE, PROJECTOR_SIZE)
    if case.method == "paper":
        return self_calibrate(matches[0], *sizes, principal_point=case.point, method="paper")
    return self_calibrate_jointly(
        matches, *sizes, principal_point=case.point, squareness_deg=case.off_deg, same=case.same
    )[0]


def outcome(case: Case, seed: int, number: int) -> Outcome:
    rng = np.random.default_rng([seed, number])
    camera, projector = (
        replace(device, distortion=(k1, k2, float(p1), float(p2), 0.0))
        for device, (k1, k2), (p1, p2) in zip(
            (PAPER_CAMERA, PAPER_PROJECTOR),
            lens_terms(case, rng),
            rng.normal(0, case.tangential, (2, 2)) if case.tangential else np.zeros((2, 2)),
            strict=True,
        )
    )
    captures = random_captures(
        rng, case.captures, camera=camera, projector=projector, walls_off_deg=case.off_deg, same=case.same
    )
    start = time.perf_counter()
    try:
        found = calibrated(case, captures)
    except RefusalError:
        return Outcome(time.perf_counter() - start)
    seconds = time.perf_counter() - start
    calibration = found.calibration
    sigma: Any = calibration.sigma
    truth = np.array([PAPER_CAMERA.focal_px[0], PAPER_PROJECTOR.focal_px[0], *PAPER_PROJECTOR.principal_point_px])
    values = [calibration.camera.focal_px[0], np.mean(calibration.projector.focal_px)]
    error = np.array([*values, *calibration.projector.principal_point_px]) - truth
    point = np.array(calibration.camera.principal_point_px) - PAPER_CAMERA.principal_point_px
    if sigma.camera.focal_px is None:  # as for `paper`
        return Outcome(seconds, error / truth)
    sigmas = np.array(
        [sigma.camera.focal_px[0], sigma.projector.focal_px[0], *sigma.projector.principal_point_px], np.float64
    )
    over_bound = None
    if case.captures == 1 or not case.same:
        knowledge = Knowledge(CAMERA_SIZE, PROJECTOR_SIZE, case.point.px, case.point.sigma_px, case.off_deg)
        over_bound = sigmas / truth / bound(captures, knowledge, NOISE_PX)
    of_columns = deviations(found, captures[0].calibration)
    return Outcome(seconds, error / truth, error / sigmas, of_columns, over_bound, float(np.abs(point).max()))


def lens_terms(case: Case, rng: np.random.Generator) -> list[tuple[float, float]]:
    """k1 and k2 of the camera, then of the projector."""
    if case.k1 is not None:
        return [(k1, 0.0) for k1 in case.k1]
    return [(float(rng.uniform(*k1)), float(rng.uniform(*k2))) for k1, k2 in ORDINARY]


def line(case: Case, outcomes: list[Outcome]) -> str:
    answered = [each for each in outcomes if each.error is not None]
    errors = [np.abs(each.error).mean() for each in answered]
    deviations = [each.deviation for each in answered if each.deviation is not None]
    ratios = [each.over_bound for each in answered if each.over_bound is not None]
    return (
        f"{case.name:40} {100 * np.mean(errors):7.3f} % {100 * np.median(errors):7.3f} % "
        + (f"{np.sqrt(np.mean(np.square(deviations))):8.2f}" if deviations else f"{'–':>8}")
        + (f"{np.median(ratios):12.2f}" if ratios else f"{'–':>12}")
        + (f"{np.mean([each.point_error_px for each in answered]):8.2f}" if case.point is CENTRE else f"{'–':>8}")
        + f"{len(outcomes) - len(answered):6d}/{len(outcomes):<4d}"
        + f"{np.median([each.seconds for each in outcomes]):6.2f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--corners", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    options = parser.parse_args()
    print(f"{'case':40} {'mean':>9} {'median':>9} {'err/σ':>8}{'σ/bound':>12}{'PP px':>8}  refused     time")
    print(f"{'':40}  four {' '.join(f'{name:>5}' for name in COLUMNS)}")
    with ProcessPoolExecutor() as pool:
        for case in CASES:
            if options.only in case.name:
                runs = pool.map(outcome, repeat(case), repeat(options.seed), range(options.corners))
                outcomes = list(runs)
                print(line(case, outcomes), flush=True)
                of_columns = [each.of_columns for each in outcomes if each.of_columns is not None]
                if of_columns:
                    print(f"{'':40} {rms_of_columns(np.stack(of_columns))}", flush=True)


if __name__ == "__main__":
    main()
