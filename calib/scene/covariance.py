"""The covariance of a rig that stations of a scene calibrate, from the curvature of the cost and the scores of places.

Errors of keypoints have long tails, and points nearby share pixels of the pictures: scores are summed by place (White,
"Maximum likelihood estimation of misspecified models", 1982; Liang and Zeger, "Longitudinal data analysis using
generalized linear models", 1986). What they scatter more than the curvature expects widens that by a factor, too; the
covariance is the mean of both, for sums over places vary.
"""

import numpy as np

from calib.numerics import Floats, Ints
from calib.refinement import SHARED
from calib.scene.problem import SceneFit, SceneProblem

_FOLLOWING = 1 / 2, 3 / 8  # terms of (1 - h)^(-1/2) - 1
_WEAKEST = 6  # directions along which the curvature is measured: two hold most of the difference
_LEAST_EIGENVALUE, _LEAST_CURVATURE = 1e-14, 0.05  # of the curvature; the latter relative to its approximation


def covariance_of_rig(problem: SceneProblem, fit: SceneFit) -> Floats:
    """The covariance (21, 21) of the rig's columns at a problem's solution; 0 where a column is held."""
    free = fit.scene.columns.free(problem.prior)
    among_free = np.ix_(free, free)
    approximate = problem.covariance(fit)
    scatter = _scatter(problem, fit, approximate)[among_free]
    inverse = _inverse_curvature(problem, fit, free)
    shared = max(1.0, float(np.trace(scatter @ approximate[among_free])) / len(free))
    covariance = np.zeros_like(approximate)
    covariance[among_free] = (shared * inverse + inverse @ scatter @ inverse) / 2
    return covariance[:SHARED, :SHARED]


def _scatter(problem: SceneProblem, fit: SceneFit, inverse: Floats) -> Floats:
    """The scatter (size, size) of the gradient, from scores that are summed by place.

    A fit follows each place by its leverage, the more the fewer places there are, and leaves smaller residuals there.
    That is undone (Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage
    samples", 2002), by a series for the root in it.
    """
    scene, observations = fit.scene, problem.observations
    residuals, place = problem.residuals(scene), scene.places
    term = _summed(residuals.scores(observations), place)
    by_place = term.copy()
    for coefficient in _FOLLOWING:
        changes = residuals.changes(observations, (term @ inverse)[place])
        term = _summed(residuals.pulls(observations, changes), place)
        by_place += coefficient * term
    by_match = problem.scores_of_matches(scene)
    scatter = by_place.T @ by_place + by_match.T @ by_match
    scatter[range(SHARED), range(SHARED)] += problem.prior.root_precision[:SHARED] ** 2
    if scene.shift_px is not None:
        shifts = scene.columns.of_shifts
        scatter[shifts, shifts] += problem.spread.drift_px**-2
    return scatter


def _inverse_curvature(problem: SceneProblem, fit: SceneFit, free: Ints) -> Floats:
    """The inverse (F, F) of half the cost's second derivatives by the `free` (F,) columns, points eliminated.

    Points follow the noise of their observations, so that the derivatives of residuals have noise, too. Gauss's and
    Newton's approximation counts its squares as information: up to half of what there is along the directions that are
    determined worst. There, differences of gradients, one sigma to both sides, tell the curvature.
    """
    information = fit.information[np.ix_(free, free)]
    scale = np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    directions = vectors / np.sqrt(np.maximum(values, _LEAST_EIGENVALUE)) / scale[:, None]
    relative = np.eye(len(free))
    for k in range(min(_WEAKEST, len(free))):
        step = np.zeros(fit.scene.size)
        step[free] = directions[:, k]
        ahead, behind = (problem.evaluate_after(fit, sign * step) for sign in (1, -1))
        slopes = directions.T @ (ahead.gradient - behind.gradient)[free] / 2
        if np.isfinite(slopes).all():
            relative[k] = relative[:, k] = slopes
    shares, axes = np.linalg.eigh(relative)
    axes = directions @ axes
    inverse: Floats = (axes / np.maximum(shares, _LEAST_CURVATURE)) @ axes.T
    return inverse


def _summed(values: Floats, group: Ints) -> Floats:
    """Sums (G, C) of `values` (N, C) by their groups (N,)."""
    total = np.zeros((int(group.max(initial=-1)) + 1, values.shape[1]))
    np.add.at(total, group, values)
    return total
