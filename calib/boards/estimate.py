"""The maximum-likelihood estimate of a rig from views of a board, with the noise that its residuals show.

Noise is that of each view's corners and matches, drawn towards that of all views.

Cross-validation of boards: each predicted by the others, and one half compared with the other.

Reprojection errors are small with enough parameters; these are prediction errors. Both are compared with the
covariance, and so test it, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from calib.boards.likelihood import BoardFit, BoardVariances, BoardView, Prior, board_problem
from calib.boards.parameters import (
    CAMERA,
    INTRINSIC_COLUMNS,
    PER_FLEX,
    PROJECTOR,
    SHARED,
    PlacedBoard,
    State,
    predict_matches,
)
from calib.estimation import Cells, Noise, joined, long_waves, noise_of
from calib.geometry import PER_POSE
from calib.numerics import CUBIC, MEDIAN_LENGTH, Floats

_LEAST_CORNER_PX = 1e-3
_PRIOR_FREEDOM = 20.0  # degrees of freedom of the prior on a view's noise, around that of all views
_FEWEST_OF_A_HALF = 2
_EXCUSED = 9.0  # variances this many times the usual are down-weighted
_USEFUL_HALF = 0.15  # sigma of a log focal length beyond which a half by itself is not compared


def measured(
    views: Sequence[BoardView], fit: BoardFit, prior: Prior
) -> tuple[BoardVariances, Floats, tuple[Noise, ...]]:
    """Levels for the likelihood, corner noise (V,) in camera px, and the noise of each view's matches.

    Each view's residuals are fitted by its pose and its part of the common parameters: half by its corners, half by its
    cells. Model errors are equal in all views of one board. If noise were estimated freely, the view with the best fit
    would gain weight, be fitted better still, and end with all of it, because a likelihood of variances has no bound.
    """
    absorbed = (np.count_nonzero(prior.sigma > 0) / len(views) + PER_POSE) / 2
    cells, of_corners, of_cells = [view.cells for view in views], fit.residuals[::2], fit.residuals[1::2]
    common = noise_of(reduce(joined, cells), np.concatenate(of_cells), absorbed * len(views))
    independent = [replace(common, inflation=1.0).variances(cell) for cell in cells]
    inflation, smooth_px = _long_waves(cells, of_cells, independent, absorbed)
    noise = tuple(
        replace(common, match_px=each.noise_px, smooth_px=float(smooth), inflation=float(kappa))
        for each, smooth, kappa in zip(cells, smooth_px, inflation, strict=True)
    )
    corner_px = _corner_sigmas(of_corners, absorbed)
    corners = [view.corner_cells(float(sigma)) for view, sigma in zip(views, corner_px, strict=True)]
    waves, _ = _long_waves(corners, of_corners, [corner.sigma_px**2 for corner in corners], absorbed)
    levels = BoardVariances(corner_px**2 * waves, tuple(map(np.multiply, independent, inflation)))
    return levels, corner_px, noise


def _corner_sigmas(residuals: Sequence[Floats], absorbed: float) -> Floats:
    """Of each view's corners, robustly, (V,)."""
    squares, freedom = [], []
    for residual in residuals:
        typical = float(np.median(np.linalg.norm(residual, axis=1))) / MEDIAN_LENGTH
        squares.append(typical**2 * residual.size)
        freedom.append(max(residual.size - absorbed, 1.0))
    variances = _drawn_together(np.array(squares), np.array(freedom))
    return np.maximum(np.sqrt(variances), _LEAST_CORNER_PX)


def _long_waves(
    parts: Sequence[Cells], residuals: Sequence[Floats], variances: Sequence[Floats], absorbed: float
) -> tuple[Floats, Floats]:
    """Of each view, (V,): overdispersion of its residuals' long waves, at least 1, and their root mean square in px."""
    waves = [long_waves(*each) for each in zip(parts, residuals, variances, strict=True)]
    totals, squares = (np.concatenate(each) for each in zip(*waves, strict=True))
    seen = np.isfinite(totals)
    if not seen.any():
        return np.ones(len(parts)), np.zeros(len(parts))
    freedom = np.where(seen, 2 * CUBIC - absorbed, 0.0)
    inflation: Floats = np.maximum(_drawn_together(np.nan_to_num(totals), freedom), 1.0)
    return inflation, np.sqrt(np.nan_to_num(squares) / [len(part) for part in parts])


def _drawn_together(squares: Floats, freedom: Floats) -> Floats:
    """Variances (V,) from sums of squares and their degrees of freedom: the mean of an inverse χ² posterior.

    Its prior is around the median of all, which one odd view does not move.
    """
    usual = np.median(squares[freedom > 0] / freedom[freedom > 0])
    return (squares + _PRIOR_FREEDOM * usual) / (freedom + _PRIOR_FREEDOM)


_ROUNDS = 60  # rounds; a dozen are usual
_SETTLED = 0.01  # relative change of a variance between rounds


@dataclass(frozen=True)
class Estimate:
    """The fit of some views, with the noise of its residuals."""

    views: tuple[BoardView, ...]
    fit: BoardFit
    prior: Prior
    levels: BoardVariances
    corner_px: Floats
    """For each view, the standard deviation of each coordinate of its corners."""
    noise: tuple[Noise, ...]
    """Of the matches of each view."""
    covariance: Floats
    """Of the common parameters, (SHARED, SHARED)."""

    @property
    def state(self) -> State:
        """The most likely one."""
        return self.fit.state


def estimate(views: Sequence[BoardView], start: State, prior: Prior, levels: BoardVariances) -> Estimate:
    """Estimate from a start near the minimum; `levels` are an initial guess of the noise.

    State and noise are estimated alternately until both converge; the result does not depend on the guess.
    """
    problem = board_problem(views, prior, levels)
    fit = problem.minimise(start)
    for _ in range(_ROUNDS):
        before = levels
        levels, corner_px, noise = measured(views, fit, prior)
        problem = board_problem(views, prior, levels)
        fit = problem.minimise(fit.state)
        if levels.change(before) < _SETTLED:
            break
    covariance = problem.covariance(fit)[:SHARED, :SHARED]
    return Estimate(tuple(views), fit, prior, levels, corner_px, noise, covariance)


@dataclass(frozen=True)
class Prediction:
    """A left out view, predicted by the others: its matches should be where its corners put it."""

    name: str
    error_px: float
    """Root mean square distance in the projector."""
    expected_px: float
    """From the covariance and the noise."""
    moved: Floats
    """Displacement of the estimate without it, (SHARED,)."""

    @property
    def sigmas(self) -> float:
        """The error over the expected one."""
        return self.error_px / self.expected_px


@dataclass(frozen=True)
class Halves:
    """Two halves of the views, by name, calibrated apart.

    `difference` and its `sigma` (6,): of log f, x_0, y_0 of the camera and of the projector.
    """

    first: tuple[str, ...]
    second: tuple[str, ...]
    difference: Floats
    sigma: Floats

    @property
    def sigmas(self) -> float:
        """Root mean square of the differences in their sigmas."""
        return float(np.sqrt(np.mean((self.difference / self.sigma) ** 2)))


def leave_one_out(estimate: Estimate, again: Callable[[Sequence[BoardView]], Estimate]) -> tuple[Prediction, ...]:
    """Each view predicted by the others; empty for fewer than three.

    `again`: estimates from some of the views.
    """
    count = len(estimate.views)
    if count < 3:
        return ()
    return tuple(_predicted(estimate, i, again([*estimate.views[:i], *estimate.views[i + 1 :]])) for i in range(count))


def _predicted(estimate: Estimate, left_out: int, rest: Estimate) -> Prediction:
    view = estimate.views[left_out]
    moved = rest.state.additive() - estimate.state.additive()
    board = estimate.state.boards[left_out]
    alone = replace(rest.state, boards=(PlacedBoard(board.pose),))
    levels = _usual_levels(estimate, left_out)
    free = np.zeros(alone.size, np.bool_)
    free[SHARED : SHARED + PER_POSE] = True
    posed = board_problem([view], estimate.prior, levels, free=free, matches=False).minimise(alone)
    predicted, jacobian, _ = predict_matches(posed.state, view.cells.camera_px, 0)
    residual = predicted - view.cells.projector_px
    pose = slice(SHARED, SHARED + PER_POSE)
    of_pose = np.asarray(np.linalg.inv(posed.information[pose, pose]), np.float64)
    # The pose follows the common parameters, so that its corners stay at their observed pixels.
    by_shared = jacobian[:, :, :SHARED] - jacobian[:, :, pose] @ (of_pose @ posed.information[pose, :SHARED])
    variance = _variance(by_shared, rest.covariance) + _variance(jacobian[:, :, pose], of_pose)
    if estimate.prior.flex:
        variance += _variance(jacobian[:, :, -PER_FLEX:], estimate.prior.flex**2 * np.eye(PER_FLEX))
    usual_px = float(
        np.median([noise.smooth_px for noise in estimate.noise])
    )  # more is an error of the view, not noise
    variance += 2 * levels.cells[0] + min(estimate.noise[left_out].smooth_px, usual_px) ** 2
    # Outliers among the cells are down-weighted, as by Huber's loss.
    square = np.minimum(np.sum(residual**2, axis=1), 9 * np.maximum(variance, np.median(np.sum(residual**2, axis=1))))
    return Prediction(view.name, float(np.sqrt(square.mean())), float(np.sqrt(variance.mean())), moved)


def _usual_levels(estimate: Estimate, view: int) -> BoardVariances:
    """A view's own levels without its smooth misfit, unless they are far above those of the others.

    Otherwise a board that moved would look noisy, and be excused.
    """
    independent = [cells / noise.inflation for cells, noise in zip(estimate.levels.cells, estimate.noise, strict=True)]
    usual = float(np.median([np.median(variances) for variances in independent]))
    own = independent[view] * min(1.0, _EXCUSED * usual / float(np.median(independent[view])))
    corners = estimate.levels.corners
    return BoardVariances(np.minimum(corners[[view]], _EXCUSED * np.median(corners)), (own,))


def _variance(jacobian: Floats, covariance: Floats) -> Floats:
    """Of x and y together, (N,)."""
    variance: Floats = np.einsum("nka,ab,nkb->n", jacobian, covariance, jacobian, optimize=True)
    return variance


def halves(estimate: Estimate, anew: Callable[[Sequence[BoardView]], Estimate]) -> Halves | None:
    """Every second view compared with the others, each half estimated `anew`, from the starts on.

    None if a half has too few views, or determines nothing.
    """
    count = len(estimate.views)
    parts = [list(range(start, count, 2)) for start in (0, 1)]
    if min(len(part) for part in parts) < _FEWEST_OF_A_HALF:
        return None
    first, second = (anew([estimate.views[i] for i in part]) for part in parts)
    variances = [part.covariance.diagonal() for part in (first, second)]
    focals = [CAMERA.start, PROJECTOR.start]
    if not all(np.sqrt(variance[focals]).max() < _USEFUL_HALF for variance in variances):
        return None
    difference = first.state.additive() - second.state.additive()
    sigma = np.sqrt(variances[0] + variances[1])
    names = [tuple(estimate.views[i].name for i in part) for part in parts]
    return Halves(names[0], names[1], difference[INTRINSIC_COLUMNS], sigma[INTRINSIC_COLUMNS])
