"""Can a calibration from boards be trusted? In words, from what tests it."""

import numpy as np

from calib.boards import ray_sigmas
from scanner.boards.calibrate import FromBoards
from scanner.results import Verdict

_MEASUREMENT_GRADE = 0.003  # sigma of a focal length
_USEFUL_RAY_PX = 1.0
_SURPRISING = 2.0  # difference of the halves, in their sigmas


def verdict_on(result: FromBoards) -> Verdict:
    """Good where both focals and all rays are known well and the halves agree."""
    calibrated = result.calibrated
    calibration, sigma = calibrated.calibration, calibrated.calibration.sigma
    relative = [
        sigmas.focal_px[0] / device.focal_px[0] if sigmas.focal_px else float("inf")
        for device, sigmas in ((calibration.camera, sigma.camera), (calibration.projector, sigma.projector))
    ]
    rays = [float(np.nanmax(sigmas)) for sigmas in ray_sigmas(calibrated.estimate, result.calibrated.calibration.sizes)]
    predicted = float(np.sqrt(np.mean([prediction.error_px**2 for prediction in calibrated.predictions])))
    expected = float(np.sqrt(np.mean([prediction.expected_px**2 for prediction in calibrated.predictions])))
    reasons = [
        f"Focal lengths are known to {100 * relative[0]:.2g} % (camera) and {100 * relative[1]:.2g} % (projector), "
        f"rays to {rays[0]:.2g} and {rays[1]:.2g} px over the common view (1 sigma).",
        f"Each board is predicted by the others to {predicted:.2g} projector px; {expected:.2g} px were expected.",
    ]
    if calibrated.halves is not None:
        reasons.append(
            "Calibrations from either half of the boards: focal lengths and principal points differ by "
            f"{calibrated.halves.sigmas:.1f} of their sigmas (root mean square; 1 is expected)."
        )
    reasons += calibrated.coverage.reasons and [f"How the boards were held: {'; '.join(calibrated.coverage.reasons)}."]
    doubtful = calibrated.halves is not None and calibrated.halves.sigmas > _SURPRISING
    if max(relative) < _MEASUREMENT_GRADE and max(rays) < _USEFUL_RAY_PX and not doubtful:
        return Verdict("good", "Calibrated, well enough to measure", tuple(reasons))
    if doubtful:
        return Verdict(
            "fair",
            "Calibrated, but two halves of the boards disagree",
            tuple(reasons),
            "Something changed between the captures, or the boards differ: make sure that nothing moves "
            "or is refocused, and that the board is flat and firm.",
        )
    return Verdict(
        "fair",
        "Calibrated, less precisely than boards can",
        tuple(reasons),
        "More captures lower the sigmas: boards at other tilts, and where the pictures are still empty.",
    )
