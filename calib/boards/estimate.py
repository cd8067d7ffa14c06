"""The maximum-likelihood estimate of a rig from views of a board, with its noise measured."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.boards.likelihood import Fit, Levels, Prior, View, minimise
from calib.boards.parameters import PER_POSE, SHARED, State
from calib.numerics import MEDIAN_LENGTH, Floats
from calib.refinement import Cells, Noise, covariance_of, noise_of

_ROUNDS = 3
_ROUGH = 0.01  # tolerance in cost while noise is measured
_LEAST_CORNER_PX = 1e-3
_PRIOR_FREEDOM = 20.0  # of a view's own corner noise, around that of all views


@dataclass(frozen=True)
class Estimate:
    """The fit of some views, with the noise that its residuals show.

    `corner_px`: for each view, the standard deviation of each coordinate of its corners. `noise`: of its matches.
    `covariance` (SHARED, SHARED) of what all views share.
    """

    views: tuple[View, ...]
    fit: Fit
    prior: Prior
    levels: Levels
    corner_px: Floats
    noise: tuple[Noise, ...]
    covariance: Floats

    @property
    def state(self) -> State:
        """The most likely one."""
        return self.fit.state


def estimate(views: Sequence[View], start: State, prior: Prior, levels: Levels) -> Estimate:
    """From a start near the minimum; `levels` are a first guess of the noise."""
    fit = minimise(views, start, prior, levels, tolerance=_ROUGH)
    for _ in range(_ROUNDS):
        levels, corner_px, noise = measured(views, fit, prior)
        fit = minimise(views, fit.state, prior, levels, tolerance=_ROUGH)
    fit = minimise(views, fit.state, prior, levels)
    covariance = covariance_of(fit.information, prior.free(fit.state))[:SHARED, :SHARED]
    return Estimate(tuple(views), fit, prior, levels, corner_px, noise, covariance)


def measured(views: Sequence[View], fit: Fit, prior: Prior) -> tuple[Levels, Floats, tuple[Noise, ...]]:
    """Levels for the likelihood, corner noise (V,) in camera px, and the noise of each view's matches.

    Each view's residuals are fitted by its pose and its part in what all share: half by its corners, half by its cells.
    """
    absorbed = (np.count_nonzero(prior.free(fit.state)[:SHARED]) / len(views) + PER_POSE) / 2
    noise = tuple(noise_of(view.cells, residual, absorbed) for view, residual in zip(views, fit.cells, strict=True))
    corner_px = _corner_sigmas(fit, absorbed)
    inflation = [
        noise_of(_as_cells(view, sigma), residual, absorbed).inflation
        for view, residual, sigma in zip(views, fit.corners, corner_px, strict=True)
    ]
    cells = tuple(level.variances(view.cells) for view, level in zip(views, noise, strict=True))
    return Levels(corner_px**2 * inflation, cells), corner_px, noise


def _corner_sigmas(fit: Fit, absorbed: float) -> Floats:
    """Of each view, robustly, drawn towards that of all where it has few corners, (V,)."""
    squares, freedom = [], []
    for residual in fit.corners:
        typical = float(np.median(np.linalg.norm(residual, axis=1))) / MEDIAN_LENGTH
        squares.append(typical**2 * residual.size)
        freedom.append(max(residual.size - absorbed, 1.0))
    together = sum(squares) / sum(freedom)
    own = (np.array(squares) + _PRIOR_FREEDOM * together) / (np.array(freedom) + _PRIOR_FREEDOM)
    sigmas: Floats = np.maximum(np.sqrt(own), _LEAST_CORNER_PX)
    return sigmas


def _as_cells(view: View, sigma_px: float) -> Cells:
    """A view's corners, for what is asked of cells: whether neighbours err alike."""
    count = len(view.points)
    one, label = np.ones(count), np.zeros(count, np.int32)
    return Cells(view.corners_px, view.corners_px, label, sigma_px * one, one, float(sigma_px), 0.0)


def of_views(found: Estimate, chosen: Sequence[int]) -> Estimate:
    """Estimated again from some of the views, noise and lenses and all, beginning with the levels that were found."""
    views = tuple(found.views[i] for i in chosen)
    levels = Levels(found.levels.corners[list(chosen)], tuple(found.levels.cells[i] for i in chosen))
    return estimate(views, found.state.of_views(chosen), found.prior, levels)
