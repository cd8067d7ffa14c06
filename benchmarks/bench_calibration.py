"""How well both methods calibrate random corners: errors, and errors in units of their own sigma.

    python benchmarks/bench_calibration.py --corners 20 --seed 0

Synthetic matches of the paper's rig (50,000 of them, 0.1 px of noise), no images. The Cramér–Rao bound is the sigma
that the refinement states, so an error/sigma of rms 1 says that the bound is reached and that the sigma is true.
"""

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np

from calib.refusal import RefusalError
from calib.selfcalibration import Method, PrincipalPoint, SelfCalibration, self_calibrate
from calib.synthetic import PAPER_CAMERA, PAPER_PROJECTOR, random_capture

CAMERA_SIZE = (PAPER_CAMERA.width, PAPER_CAMERA.height)
PROJECTOR_SIZE = (PAPER_PROJECTOR.width, PAPER_PROJECTOR.height)
CENTRE = PrincipalPoint(((CAMERA_SIZE[0] - 1) / 2, (CAMERA_SIZE[1] - 1) / 2), 70.0)
KNOWN = PrincipalPoint(PAPER_CAMERA.principal_point_px, 0.0)


@dataclass(frozen=True)
class Case:
    name: str
    method: Method
    k1: tuple[float, float]
    principal_point: PrincipalPoint
    walls_off_deg: float
    squareness_deg: float


CASES = (
    Case("paper, no lens terms", "paper", (0.0, 0.0), KNOWN, 0.0, 0.0),
    Case("paper, k1 −0.02/−0.01", "paper", (-0.02, -0.01), KNOWN, 0.0, 0.0),
    Case("refined, no lens terms", "refined", (0.0, 0.0), KNOWN, 0.0, 0.0),
    Case("refined, k1 −0.02/−0.01", "refined", (-0.02, -0.01), KNOWN, 0.0, 0.0),
    Case("refined, PP unknown, k1 −0.06/−0.03", "refined", (-0.06, -0.03), CENTRE, 0.0, 0.0),
    Case("refined, walls off by 0.3°", "refined", (-0.02, -0.01), KNOWN, 0.3, 0.3),
)


def errors_of(found: SelfCalibration) -> tuple[np.ndarray, np.ndarray | None]:
    """Relative errors of (f_c, f_p, x_p, y_p), and the same in sigmas where sigmas are known."""
    calibration, sigma = found.calibration, found.calibration.sigma
    truth = np.array([PAPER_CAMERA.focal_px[0], PAPER_PROJECTOR.focal_px[0], *PAPER_PROJECTOR.principal_point_px])
    values = [calibration.camera.focal_px[0], np.mean(calibration.projector.focal_px)]
    error = np.array([*values, *calibration.projector.principal_point_px]) - truth
    if not sigma:
        return error / truth, None
    sigmas = [sigma["camera_focal_px"], sigma["projector_focal_px"], *sigma["projector_principal_point_px"]]
    return error / truth, error / np.array(sigmas)


def run(case: Case, corners: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = replace(PAPER_CAMERA, distortion=(case.k1[0], 0.0, 0.0, 0.0, 0.0))
    projector = replace(PAPER_PROJECTOR, distortion=(case.k1[1], 0.0, 0.0, 0.0, 0.0))
    errors, deviations, seconds, refused = [], [], [], 0
    for _ in range(corners):
        capture = random_capture(rng, camera=camera, projector=projector, walls_off_deg=case.walls_off_deg)
        start = time.perf_counter()
        try:
            found = self_calibrate(
                capture.matches,
                CAMERA_SIZE,
                PROJECTOR_SIZE,
                principal_point=case.principal_point,
                method=case.method,
                squareness_deg=case.squareness_deg,
            )
        except RefusalError:
            refused += 1
            continue
        finally:
            seconds.append(time.perf_counter() - start)
        error, deviation = errors_of(found)
        errors.append(np.abs(error).mean())
        if deviation is not None:
            deviations.append(deviation)
    rms = f"{np.sqrt(np.mean(np.square(deviations))):5.2f}" if deviations else "    –"
    means = f"{100 * np.mean(errors):7.3f} % {100 * np.median(errors):7.3f} %" if errors else " " * 19
    print(f"{case.name:38} {means} {rms:>10} {refused:4d}/{corners:<4d} {np.median(seconds):6.2f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--corners", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(f"{'case':38} {'mean':>9} {'median':>9} {'rms err/σ':>10}  refused    time")
    for case in CASES:
        run(case, options.corners, options.seed)


if __name__ == "__main__":
    main()
