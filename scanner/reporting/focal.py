"""The camera's focal length: how well it is determined, and which other values were in question."""

from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from calib.arrays import Floats
from calib.cells import into_cells
from calib.homography import TooFewMatchesError
from calib.likelihood import Knowledge
from calib.paper import Objective, exact_search
from calib.selfcalibration import paper_trials
from calib.sweep import family_of
from scanner.reporting import plots
from scanner.reporting.contents import ReportInput
from scanner.reporting.plots import local_minima

# Enough for the curve's shape to the width of its line.
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
    """Both curves, as far as there are labelled faces; None if there is neither."""
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
    matches = solution.matches if solution else report.matches
    if matches.face is None or (report.refusal is None and solution is None):
        return None
    width, height = report.capture.camera_size
    centre = solution.calibration.camera.principal_point_px if solution else ((width - 1) / 2, (height - 1) / 2)
    labelled = np.flatnonzero(matches.face >= 0)
    sample = matches[labelled[:: max(1, len(labelled) // _SAMPLE)].astype(np.int32)]
    knowledge = Knowledge((width, height), report.capture.projector_size, centre, 0.0, _SQUARE)
    try:
        family = family_of(into_cells(sample), knowledge)
    except TooFewMatchesError:
        return None
    chosen = solution.calibration.camera.focal_px[0] if solution else None
    return plots.objective_plot(*_searched(family.objective, paper_trials((width, height))), chosen)


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
