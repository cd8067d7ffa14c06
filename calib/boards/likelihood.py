"""The likelihood of all views of a board for a state, with derivatives; and priors on lenses and boards.

Corners deviate in camera pixels, cells of matches in projector pixels, both under Huber's loss.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.boards.parameters import (
    ASPECT,
    BEND,
    CAMERA,
    CENTRE,
    FOCAL,
    LENS,
    PER_DEVICE,
    PROJECTOR,
    SHARED,
    State,
    predict_corners,
    predict_matches,
)
from calib.numerics import NIELSEN, Bools, Floats, Quadratic, descend
from calib.refinement import ORDINARY_LENSES, Cells, ColumnPrior, LensPrior, misfit

_STEPS = 60
_TAILED = np.array(
    [[device.start + term] for device in (CAMERA, PROJECTOR) for term in (ASPECT, *range(LENS.start, LENS.stop))]
)
CONVERGED = 1e-4  # in cost: a hundredth of a sigma
# Prior sigmas of devices and boards: they determine what a set of views leaves open.
_ASPECT_SIGMA = 0.002
_LOG_FOCAL_SIGMA = 1.0
_BEND_SIGMA = (0.01, 0.01, 0.01, 0.003, 0.003, 0.003, 0.003)


@dataclass(frozen=True)
class BoardView:
    """One pose of the board: its corners `points` (N, 2), in lengths from its middle, `corners_px` (N, 2) where the
    camera saw them, and the `cells` of matches on it. `name` says in messages which it is.
    """

    name: str
    points: Floats
    corners_px: Floats
    cells: Cells


@dataclass(frozen=True)
class BoardVariances:
    """Variances of each coordinate: of the corners of each view (V,), of each view's cells, (M,) each."""

    corners: Floats
    cells: tuple[Floats, ...]

    def change(self, before: "BoardVariances") -> float:
        """The largest difference of a variance's logarithm."""
        pairs = zip((self.corners, *self.cells), (before.corners, *before.cells), strict=True)
        return max(float(np.abs(np.log(own / earlier)).max()) for own, earlier in pairs)


@dataclass(frozen=True)
class Prior(ColumnPrior):
    """Prior on the shared columns, (SHARED,). Tailed are lens terms and the pixels' shape.

    `flex`: standard deviation of each term by which a view's bend differs from the usual one; 0 for a rigid board.
    """

    flex: float = 0.0

    def free(self, layout: State) -> Bools:
        """Which columns are estimated, (size,)."""
        free = np.ones(layout.size, np.bool_)
        free[:SHARED] = self.sigma > 0
        free[layout.flex_columns()] = self.flex > 0
        return free


def device_prior(
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    bend_terms: int,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
) -> Prior:
    """Prior for devices of these sizes (width, height) and a board with this number of terms of its bend."""
    mean, sigma = np.zeros(SHARED), np.full(SHARED, np.inf)
    sizes = camera_size, projector_size
    for device, (width, height), lens in zip((CAMERA, PROJECTOR), sizes, lenses, strict=True):
        of_device = np.zeros(PER_DEVICE), np.zeros(PER_DEVICE)
        of_device[0][FOCAL], of_device[1][FOCAL] = np.log(1.2 * width), _LOG_FOCAL_SIGMA
        of_device[1][ASPECT] = _ASPECT_SIGMA
        of_device[0][CENTRE], of_device[1][CENTRE] = ((width - 1) / 2, (height - 1) / 2), height / 2
        of_device[0][LENS], of_device[1][LENS] = lens.mean, lens.sigma
        mean[device], sigma[device] = of_device
    sigma[BEND] = _BEND_SIGMA
    sigma[BEND.start + bend_terms : BEND.stop] = 0.0
    return Prior(mean, sigma, (_TAILED,))


@dataclass(frozen=True)
class Fit(Quadratic):
    """A state with its cost; residuals of the `corners` in camera px and of the `cells` in projector px, by view."""

    state: State
    corners: tuple[Floats, ...]
    cells: tuple[Floats, ...]


def evaluate(
    views: Sequence[BoardView], state: State, prior: Prior, levels: BoardVariances, *, matches: bool = True
) -> Fit:
    """The cost of a state with its derivatives; infinite if more than outliers fall behind a device.

    Without `matches`, only the camera is evaluated.
    """
    of_columns, slope, curvature = prior.misfit(state.additive())
    cost = float(of_columns.sum())
    gradient, information = np.zeros(state.size), np.zeros((state.size, state.size))
    gradient[:SHARED], information[:SHARED, :SHARED] = slope, np.diag(curvature)
    if prior.flex:
        columns, flex = (
            state.flex_columns().ravel(),
            np.concatenate([board.flex for board in state.boards]) / prior.flex,
        )
        cost += float(flex @ flex)
        gradient[columns], information[columns, columns] = flex / prior.flex, prior.flex**-2.0
    corners, cells = [], []
    for i, view in enumerate(views):
        columns = state.columns(i)
        predicted, jacobian, depth = predict_corners(state, view.points, i)
        residual = np.empty_like(predicted)
        corners_px, depths = np.ascontiguousarray(view.corners_px), np.stack([depth, depth], axis=1)
        variance = np.full(len(corners_px), levels.corners[i])
        cost += misfit(predicted, corners_px, jacobian, depths, variance, columns, residual, gradient, information)
        corners.append(residual)
        if not matches:
            continue
        predicted, jacobian, depths = predict_matches(state, view.cells.camera_px, i)
        residual = np.empty_like(predicted)
        corners_px = np.ascontiguousarray(view.cells.projector_px)
        cost += misfit(
            predicted, corners_px, jacobian, depths, levels.cells[i], columns, residual, gradient, information
        )
        cells.append(residual)
    if not np.isfinite(cost):
        cost = np.inf
    return Fit(cost, gradient, information, state, tuple(corners), tuple(cells))


def minimise(
    views: Sequence[BoardView],
    state: State,
    prior: Prior,
    levels: BoardVariances,
    *,
    free: Bools | None = None,
    matches: bool = True,
    tolerance: float = CONVERGED,
    steps: int = _STEPS,
) -> Fit:
    """The nearest minimum over the `free` columns (size,), by default all that the prior does not know.

    Ends when a further step promises to lower the cost by less than `tolerance`.
    """
    columns = np.flatnonzero(prior.free(state) if free is None else free)

    def moved(fit: Fit, step: Floats) -> Fit:
        return evaluate(views, fit.state.moved(step), prior, levels, matches=matches)

    start = evaluate(views, state, prior, levels, matches=matches)
    return descend(start, moved, lambda _, decrement: decrement < tolerance, NIELSEN, steps, free=columns)
