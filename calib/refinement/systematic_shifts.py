"""What matches that are shifted, all of them by a smooth field, do to the solution: to first order, without a new fit.

With half the Hessian H of the cost, cells' Jacobians J and variances v, a field of shifts s moves the minimum by
H⁻¹ Σ Jᵀ s / v. The parameters absorb most of such a field, so that the residuals do not show it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from calib.refinement.image_polynomial import CUBIC, monomials
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import CAMERA, PROJECTOR, State, predict
from calib.refinement.refine import Refinement

# Camera pixels (N, 2), projector pixels (N, 2), and the gradient (N, 2, 2) of these (rows) by the camera's x and y → by
# how much the projector pixels are shifted, (N, 2).
Shift = Callable[[Floats, Floats, Floats], Floats]

_STEP_PX = 0.5


@dataclass(frozen=True)
class Shifts:
    """By what the matches of a capture may be shifted, by fields of one standard deviation each: `likely` ones, and
    `possible` ones, which nothing tells of. `smooth_px`: by what a decoder errs smoothly over each plane, along either
    axis: the standard deviation of the amplitude of every polynomial up to the cubic ones, orthonormal in the mean.
    `decoding`: what else it errs by, whether anything moved or not.
    """

    likely: tuple[Shift, ...] = ()
    possible: tuple[Shift, ...] = ()
    smooth_px: float = 0.0
    decoding: tuple[Shift, ...] = ()


def response_to_shift(refinement: Refinement, shift: Shift, capture: int) -> Floats:
    """By how much the solution (size,) changes if the matches of a capture are shifted so."""
    state, cells = refinement.fit.state, refinement.captures[capture]
    shifts = shift(cells.camera_px, cells.projector_px, _gradient(state, cells, capture))
    return _responses(refinement, shifts[..., None], capture)[:, 0]


def covariance_of_smooth_errors(refinement: Refinement, smooth_px: float, capture: int) -> Floats:
    """The covariance (size, size) that errors as of `Shifts.smooth_px` give the solution.

    They are the same in all captures from one place, so that together these are moved as one is.
    """
    cells, times = refinement.captures[capture], refinement.noise[capture].repeats
    fields = []
    for plane in np.unique(cells.plane):
        members = np.flatnonzero(cells.plane == plane)
        modes, _ = np.linalg.qr(monomials(cells.camera_px[members])[:, :CUBIC])
        for axis in (0, 1):
            field = np.zeros((len(cells), 2, modes.shape[1]))
            field[members, axis] = smooth_px * np.sqrt(len(members)) * modes
            fields.append(field)
    responses = _responses(refinement, np.concatenate(fields, axis=2), capture)
    covariance: Floats = times * responses @ responses.T
    return covariance


def _responses(refinement: Refinement, fields: Floats, capture: int) -> Floats:
    """By how much the solution changes, (size, K), if the cells of a capture are shifted by fields (M, 2, K)."""
    state, cells = refinement.fit.state, refinement.captures[capture]
    _, jacobian, _ = predict(state, cells.camera_px, cells.plane, capture)
    weighted = jacobian / refinement.noise[capture].variances(cells)[:, None, None]
    pull = np.zeros((state.size, fields.shape[2]))
    np.add.at(pull, state.columns(capture), np.einsum("nac,nak->ck", weighted, fields, optimize=True))
    free = refinement.prior.free_columns
    responses = np.zeros_like(pull)
    responses[free] = np.linalg.solve(refinement.fit.information[np.ix_(free, free)], pull[free])
    return responses


def percent_of_intrinsics(state: State, step: Floats) -> float:
    """How far a step (size,) moves both focal lengths and the projector's principal point, on average, in per cent."""
    point = slice(PROJECTOR.start + 1, PROJECTOR.start + 3)
    focals = step[[CAMERA.start, PROJECTOR.start]]  # logarithms
    return float(100 * np.mean(np.abs([*focals, *(step[point] / state.additive()[point])])))


def together(responses: Sequence[Floats], size: int) -> Floats:
    """The covariance (size, size) of independent shifts of one standard deviation each, from what each does."""
    rows = np.reshape(responses, (-1, size))
    covariance: Floats = rows.T @ rows
    return covariance


def _gradient(state: State, cells: Cells, capture: int) -> Floats:
    columns = []
    for step in (np.array([_STEP_PX, 0.0]), np.array([0.0, _STEP_PX])):
        after, before = (predict(state, cells.camera_px + way * step, cells.plane, capture)[0] for way in (1, -1))
        columns.append((after - before) / (2 * _STEP_PX))
    return np.stack(columns, axis=2)
