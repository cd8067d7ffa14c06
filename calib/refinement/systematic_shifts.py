"""What matches that are shifted, all of them by a smooth field, do to the solution: to first order, without a new fit.

With half the Hessian H of the cost, cells' Jacobians J and variances v, a field of shifts s moves the minimum by
H⁻¹ Σ Jᵀ s / v.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
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
    `possible` ones, which nothing tells of.
    """

    likely: tuple[Shift, ...] = ()
    possible: tuple[Shift, ...] = ()


def response_to_shift(refinement: Refinement, shift: Shift, capture: int) -> Floats:
    """By how much the solution (size,) changes if the matches of a capture are shifted so."""
    state, cells = refinement.fit.state, refinement.captures[capture]
    _, jacobian, _ = predict(state, cells.camera_px, cells.plane, capture)
    shifts = shift(cells.camera_px, cells.projector_px, _gradient(state, cells, capture))
    pull = np.zeros(state.size)
    weighted = shifts / refinement.noise[capture].variances(cells)[:, None]
    np.add.at(pull, state.columns(capture), np.einsum("nkc,nk->c", jacobian, weighted))
    free = refinement.prior.free_columns
    response = np.zeros(state.size)
    response[free] = np.linalg.solve(refinement.fit.information[np.ix_(free, free)], pull[free])
    return response


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
