"""The first-order effect of a smooth shift field of the matches on the solution, without a new fit.

With half the Hessian H of the cost, cells' Jacobians J and variances v, a field of shifts s moves the minimum by
H⁻¹ Σ Jᵀ s / v. The parameters absorb most of such a field, so that the residuals do not show it.
"""

from collections.abc import Sequence

import numpy as np

from calib.estimation import Shift, pull_of_shifts, smooth_fields
from calib.numerics import Floats, by_pixel
from calib.refinement.parameters import CAMERA, PROJECTOR, State, predict
from calib.refinement.refine import Refinement


def response_to_shift(refinement: Refinement, shift: Shift, capture: int) -> Floats:
    """Return the change (size,) of the solution if the matches of a capture are shifted by `shift`."""
    state, cells = refinement.fit.state, refinement.captures[capture]
    gradient = by_pixel(lambda pixels: predict(state, pixels, cells.plane, capture)[0], cells.camera_px)
    shifts = shift(cells.camera_px, cells.projector_px, gradient)
    return _responses(refinement, shifts[..., None], capture)[:, 0]


def covariance_of_smooth_errors(refinement: Refinement, smooth_px: float, capture: int) -> Floats:
    """Return the covariance (size, size) of the solution due to smooth errors, see `Shifts.smooth_px`.

    The errors are equal in all captures from one place, so averaging those captures does not reduce them.
    """
    cells, times = refinement.captures[capture], refinement.noise[capture].repeats
    fields = []
    for plane in np.unique(cells.plane):
        members = cells.plane == plane
        modes = smooth_px * smooth_fields(cells.camera_px[members])
        field = np.zeros((len(cells), *modes.shape[1:]))
        field[members] = modes
        fields.append(field)
    responses = _responses(refinement, np.concatenate(fields, axis=2), capture)
    return times * responses @ responses.T


def _responses(refinement: Refinement, fields: Floats, capture: int) -> Floats:
    """Return the changes (size, K) of the solution if the cells of a capture are shifted by fields (M, 2, K)."""
    problem, fit = refinement.problem, refinement.fit
    pull = pull_of_shifts(fit.state, problem.parts[capture], problem.variances[capture], fields)
    return problem.response(fit, pull)


def percent_of_intrinsics(state: State, step: Floats) -> float:
    """Return the average change in per cent of both focals and the projector's principal point by a step (size,)."""
    point = slice(PROJECTOR.start + 1, PROJECTOR.start + 3)
    focals = step[[CAMERA.start, PROJECTOR.start]]  # logarithms
    return float(100 * np.mean(np.abs([*focals, *(step[point] / state.additive()[point])])))


def together(responses: Sequence[Floats], size: int) -> Floats:
    """Return the covariance (size, size) of independent shifts of one standard deviation, given their responses."""
    rows = np.reshape(responses, (-1, size))
    return rows.T @ rows
