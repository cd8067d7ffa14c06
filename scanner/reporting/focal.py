"""The camera's focal length: how well it is determined, and which other values were in question."""

from dataclasses import dataclass, replace

import numpy as np
from markupsafe import Markup

from calib.closed_form import Objective, exact_search, objective_for
from calib.estimation import into_cells
from calib.geometry import Calibration, Intrinsics, Matches, TooFewMatchesError
from calib.numerics import Floats
from calib.refinement import Knowledge, family_of
from calib.self_calibration import paper_trials
from scanner.reporting import plots
from scanner.reporting.contents import ReportInput
from scanner.reporting.plots import local_minima

# Enough samples for a smooth curve.
_SAMPLE = 20_000
_SQUARE = 0.0
_AROUND_A_MINIMUM = 14


@dataclass(frozen=True)
class FocalLength:
    """`likelihood`: the profile that the refinement ended with, None for other methods. `objective`: E(f_c) of the
    paper; `centred`: for a principal point in the image's centre, for want of a better one.
    """

    likelihood: Markup | None
    objective: Markup | None
    centred: bool


def focal_length(report: ReportInput) -> FocalLength | None:
    """Plot both curves, as far as there are labelled faces; None if there is neither."""
    solution = report.solution
    likelihood = None
    if solution is not None and solution.method == "refined":
        likelihood = plots.likelihood_plot(solution.profile, solution.calibration.camera.focal_px[0])
    objective = _objective(report)
    if likelihood is None and objective is None:
        return None
    return FocalLength(likelihood, objective, solution is None)


def _objective(report: ReportInput) -> Markup | None:
    """E(f_c): as it was searched, or for the same faces with the lenses' bending taken off."""
    solution = report.solution
    if solution is not None and solution.method == "paper":
        profile = solution.profile
        return plots.objective_plot(profile.focal_px, profile.cost, solution.calibration.camera.focal_px[0])
    if not len(report.on_faces) or (report.reconstructed and solution is None):
        return None
    sample = report.on_faces[:: max(1, len(report.on_faces) // _SAMPLE)]
    size = report.metadata.camera_size
    try:
        objective = _by_calibration(sample, solution.calibration) if solution else _by_straightness(sample, report)
    except TooFewMatchesError:
        return None
    chosen = solution.calibration.camera.focal_px[0] if solution else None
    return plots.objective_plot(*_searched(objective, paper_trials(size)), chosen)


def _by_calibration(matches: Matches, calibration: Calibration) -> Objective:
    """The objective of pinhole cameras, the bend of whose lenses the calibration knows."""
    camera_px = _without_bend(matches.camera_px, calibration.camera)
    projector_px = _without_bend(matches.projector_px, calibration.projector)
    known = np.flatnonzero(np.isfinite(camera_px + projector_px).all(axis=1))
    straight = replace(matches[known], camera_px=camera_px[known], projector_px=projector_px[known])
    return objective_for(straight, calibration.camera.principal_point_px)


def _without_bend(pixels: Floats, device: Intrinsics) -> Floats:
    """Undistort pixels (N, 2); NaN where the lens model has no inverse."""
    straight: Floats = device.unproject(pixels)[:, :2] * np.array(device.focal_px) + np.array(device.principal_point_px)
    return straight


def _by_straightness(matches: Matches, report: ReportInput) -> Objective:
    """The objective of lenses whose bend makes the faces' homographies straight, for want of a calibration."""
    width, height = report.metadata.camera_size
    centre = (width - 1) / 2, (height - 1) / 2
    knowledge = Knowledge((width, height), report.metadata.projector_size, centre, 0.0, _SQUARE)
    return family_of(into_cells(matches), knowledge).objective


def _searched(objective: Objective, focal_px: Floats) -> tuple[Floats, Floats]:
    """E at trial focals (n,), and more densely around its minima."""
    values = exact_search(objective, focal_px)
    around = [np.geomspace(focal_px[i - 1], focal_px[i + 1], _AROUND_A_MINIMUM + 2)[1:-1] for i in local_minima(values)]
    more = np.concatenate([np.zeros(0), *around])
    if not len(more):
        return focal_px, values
    every = np.concatenate([focal_px, more])
    order = np.argsort(every)
    return every[order], np.concatenate([values, exact_search(objective, more)])[order]
