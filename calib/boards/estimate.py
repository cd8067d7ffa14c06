"""The maximum-likelihood estimate of a rig from views of a board, with the noise that its residuals show.

Noise is that of each view's corners and matches, drawn towards that of all views.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from calib.boards.likelihood import BoardFit, BoardVariances, BoardView, Prior, board_problem
from calib.boards.parameters import SHARED, State
from calib.estimation import Cells, Noise, joined, long_waves, noise_of
from calib.geometry import PER_POSE
from calib.numerics import CUBIC, MEDIAN_LENGTH, Floats

_LEAST_CORNER_PX = 1e-3
_PRIOR_FREEDOM = 20.0  # degrees of freedom of the prior on a view's noise, around that of all views


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
    """The fit of some views, with the noise of its residuals.

    `corner_px`: for each view, the standard deviation of each coordinate of its corners. `noise`: of its matches.
    `covariance` (SHARED, SHARED) of the common parameters.
    """

    views: tuple[BoardView, ...]
    fit: BoardFit
    prior: Prior
    levels: BoardVariances
    corner_px: Floats
    noise: tuple[Noise, ...]
    covariance: Floats

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
