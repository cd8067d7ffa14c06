"""This project's methods of the first table: the paper's search as published, and the refined one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from calib.closed_form import Objective, objective_for
from calib.geometry import Calibration, Matches
from calib.refinement import ORDINARY_LENSES, LensPrior
from calib.refusal import RefusalError
from calib.self_calibration import PrincipalPoint, paper_trials, self_calibrate, self_calibrate_jointly
from paper.captures import FULL, Setup
from scanner.quantities import intrinsic_errors_percent

CENTRE_SIGMA_OF_WIDTH = 0.03  # prior of the configuration on an unknown principal point
ORDINARY_WALLS_DEG = 0.3
CONFIGURATIONS = (*((i,) for i in range(7)), (0, 1), (2, 3, 4, 5, 6), tuple(range(7)))
_STEP_PX = 1.0  # step of the exact search in the camera's full image, as in the paper
_AT_ONCE = 2000

Errors = list[float] | None


def known_point(truth: Calibration) -> PrincipalPoint:
    return PrincipalPoint(truth.camera.principal_point_px, 0.0)


def unknown_point(setup: Setup) -> PrincipalPoint:
    width, height = setup.camera_size
    return PrincipalPoint(((width - 1) / 2, (height - 1) / 2), CENTRE_SIGMA_OF_WIDTH * width)


def errors_of(calibrate: Callable[[], Calibration], truth: Calibration) -> Errors:
    """Signed errors of (f_c, f_p, x_p, y_p) in per cent; None for a refusal."""
    try:
        found = calibrate()
    except RefusalError as refusal:
        print(f"    refused: {refusal.reason[:200]}")
        return None
    return [float(error) for error in intrinsic_errors_percent(found, truth)]


def by_paper(matches: Matches, truth: Calibration) -> Calibration:
    """The published method with a known principal point; raises RefusalError."""
    sizes = truth.camera.size, truth.projector.size
    return self_calibrate(matches, *sizes, principal_point=known_point(truth), method="paper").calibration


def refined(
    captures: list[Matches],
    truth: Calibration,
    point: PrincipalPoint,
    squareness_deg: float = 0.0,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
) -> Calibration:
    """Maximum likelihood from one capture, or jointly from several of one corner; raises RefusalError."""
    sizes = truth.camera.size, truth.projector.size
    found = self_calibrate_jointly(
        captures, *sizes, principal_point=point, squareness_deg=squareness_deg, lenses=lenses
    )
    return found[0].calibration


def refined_knowing(matches: Matches, truth: Calibration, squareness_deg: float = 0.0) -> Calibration:
    """Of ideal lenses with both true principal points, all of which is said; raises RefusalError."""
    ideal = LensPrior().with_sigmas(decentering=0.0, k3=0.0, radial=0.0)
    projector = replace(ideal, point=PrincipalPoint(truth.projector.principal_point_px, 0.0))
    return refined([matches], truth, known_point(truth), squareness_deg, (ideal, projector))


def by_configurations(matches: Matches, truth: Calibration) -> list[Errors]:
    """Solutions of the paper's ten objectives: the terms 1 … 7, two partial sums, and the total.

    The exact search of section 4.1, in steps of a pixel; None if no focal length gives a real corner.
    """
    objective = objective_for(matches, truth.camera.principal_point_px)
    shortest, longest = paper_trials(truth.camera.size)[[0, -1]]
    focals = np.arange(shortest, longest, _STEP_PX * truth.camera.width / FULL.width)
    best: list[tuple[float, np.ndarray]] = [(np.inf, np.empty(0))] * len(CONFIGURATIONS)
    for start in range(0, len(focals), _AT_ONCE):
        _search(objective, focals[start : start + _AT_ONCE], best)
    true = np.array([truth.camera.focal_px[0], truth.projector.focal_px[0], *truth.projector.principal_point_px])
    return [
        [float(error) for error in 100 * (found / true - 1)] if np.isfinite(lowest) else None for lowest, found in best
    ]


def _search(objective: Objective, focals: np.ndarray, best: list[tuple[float, np.ndarray]]) -> None:
    """Replace each configuration's lowest value and its solution, (f_c, f_p, x_p, y_p), where these are lower."""
    forward, in_front = objective.forward(focals)
    terms = objective.terms(focals, forward)
    usable = in_front & np.isfinite(terms).all(axis=0)
    for number, configuration in enumerate(CONFIGURATIONS):
        total = np.where(usable, terms[list(configuration)].sum(axis=0), np.inf)
        lowest = int(np.argmin(total))
        if total[lowest] < best[number][0]:
            matrix = forward.matrix[lowest]
            focal = focals[lowest % len(focals)]
            found = np.array([focal, (matrix[0, 0] + matrix[1, 1]) / 2, matrix[0, 2], matrix[1, 2]])
            best[number] = float(total[lowest]), found
