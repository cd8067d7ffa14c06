"""The published method: the focal length at which the transfer between the devices closes, on a square corner."""

import numpy as np

from calib.closed_form import Objective, search
from calib.diagnostics import no_corner
from calib.estimation import into_cells
from calib.finding import Finding, FindingKind, Severity
from calib.geometry import Calibration, Corner, Intrinsics, Matches, Pose, before_the_matches
from calib.refusal import RIG, RefusalError
from calib.self_calibration.result import Profile, SelfCalibration, paper_trials

_CLOSED_CYCLE = 0.1  # paper's objective, in camera focals

PAPER_METHOD = FindingKind(
    "paper-method",
    "The paper's method models neither lens distortion nor uncertainty; it is meant for comparison.",
    "Use 'method: refined'.",
)
PAPER_FAILED = FindingKind(
    "paper-failed",
    "The paper's objective has no minimum, or its transfer between the devices does not close.",
    "Use 'method: refined', or show all three faces large and at different slants to both devices.",
)


def calibrate_by_paper(
    objective: Objective,
    matches: Matches,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
) -> SelfCalibration:
    """Calibrate by the published one-dimensional search over the camera's focal length.

    Raises RefusalError if the objective has no minimum, or if the transfer between the devices does not close.
    """
    solution = search(objective, paper_trials(camera_size))
    if solution is None:
        raise no_corner([into_cells(matches)], RIG)
    low, high = solution.focal_px[1], solution.focal_px[-2]
    if not low < solution.best_focal_px < high:
        raise RefusalError(
            PAPER_FAILED,
            f"The objective has no minimum for camera focal lengths between {low:.0f} and {high:.0f} px.",
            RIG.move,
        )
    lowest = float(np.min(solution.objective))
    if lowest > _CLOSED_CYCLE * solution.best_focal_px:
        raise RefusalError(
            PAPER_FAILED,
            f"The transfer between the devices does not close: the objective's minimum is {lowest:.0f} px.",
            RIG.move,
        )
    best = solution.best
    baseline = float(np.linalg.norm(best.translation[0]))
    matrix = best.matrix[0]
    calibration = Calibration(
        Intrinsics(*camera_size, (solution.best_focal_px,) * 2, objective.principal_point_px),
        Intrinsics(
            *projector_size,
            (float(matrix[0, 0]), float(matrix[1, 1])),
            (float(matrix[0, 2]), float(matrix[1, 2])),
        ),
        Pose(best.rotation[0], best.translation[0] / baseline),
    )
    corner, residual_px = before_the_matches(Corner(best.vertex[0] / baseline, best.normals[0]), calibration, matches)
    return SelfCalibration(
        calibration,
        matches,
        corner,
        Profile(solution.focal_px, solution.objective),
        residual_px,
        "paper",
        (
            Finding(
                PAPER_METHOD,
                Severity.NOTE,
                "The paper's method models neither lens distortion nor uncertainty: with ordinary lenses its error is "
                "several per cent. It is meant for comparison; use the method 'refined' instead.",
            ),
        ),
    )
