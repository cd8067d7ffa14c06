"""The covariance of a rig that stations of a scene calibrate, from the curvature of the cost and the scores of places.

Errors of keypoints have long tails, and points nearby share pixels of the pictures: scores are summed by place (White,
"Maximum likelihood estimation of misspecified models", 1982; Liang and Zeger, "Longitudinal data analysis using
generalized linear models", 1986). What they scatter more than the curvature expects widens that by a factor, too; the
covariance is the mean of both, for sums over places vary.

A rig that warms up shifts the projector's picture from station to station. How far is told by what shifts of whole
stations would gain, and what they do to the rig is added.
"""

import numpy as np

from calib.numerics import Floats, Ints, huber_weights
from calib.refinement import SHARED
from calib.scene.bundle import HUBER_SIGMAS, RigidScene, SceneFit, evaluate_after, missed, residuals_of
from calib.scene.problem import SceneProblem
from calib.scene.views import WINDOW_PIXELS

_PLACE_WINDOWS = 4.0  # windows of pixels that the side of a place is
_FOLLOWING = 1 / 2, 3 / 8  # terms of (1 - h)^(-1/2) - 1
_WEAKEST = 6  # directions along which the curvature is measured: two hold most of the difference
_LEAST_SHARE = 1e-4  # of the best determined shift, of one that is undetermined
_LEAST_EIGENVALUE, _LEAST_CURVATURE = 1e-14, 0.05  # of the curvature; the latter relative to its approximation


def covariance_of_rig(problem: SceneProblem, fit: SceneFit) -> Floats:
    """The covariance (21, 21) of the rig's columns at a problem's solution; 0 where a column is held."""
    free = problem.free_columns(fit.scene.size)
    among_free = np.ix_(free, free)
    approximate = problem.inverted(fit.information)
    scatter = _scatter(problem, fit, approximate)[among_free]
    inverse = _inverse_curvature(problem, fit, free)
    shared = max(1.0, float(np.trace(scatter @ approximate[among_free])) / len(free))
    by_drift = _by_drift(problem, fit, approximate, shared)[free]
    scatter_by_drift = by_drift @ by_drift.T
    covariance = np.zeros_like(approximate)
    covariance[among_free] = (shared * inverse + inverse @ scatter @ inverse) / 2 + inverse @ scatter_by_drift @ inverse
    return covariance[:SHARED, :SHARED]


def _scatter(problem: SceneProblem, fit: SceneFit, inverse: Floats) -> Floats:
    """The scatter (size, size) of the gradient, from scores that are summed by place.

    A fit follows each place by its leverage, the more the fewer places there are, and leaves smaller residuals there.
    That is undone (Bell and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage
    samples", 2002), by a series for the root in it.
    """
    scene, observations = fit.scene, problem.observations
    residuals, place = residuals_of(scene, observations, problem.spread), _places(scene)
    own, pull_on_points, mixed = residuals.by_points(observations, scene.size)
    pulls = residuals.pulls(observations, scene.size)
    pulls -= (np.linalg.solve(own, pull_on_points[..., None])[:, None, :, 0] @ mixed)[:, 0]
    term = _summed(pulls, place)
    by_place = term.copy()
    for coefficient in _FOLLOWING:
        changes = residuals.changes(observations, (term @ inverse)[place])
        term = _summed(residuals.pulls(observations, scene.size, changes), place)
        by_place += coefficient * term
    scatter = by_place.T @ by_place
    miss, by_shared = missed(scene.rig, problem.matches, problem.spread)
    by_match = by_shared * (huber_weights(np.abs(miss), HUBER_SIGMAS) * miss)[:, None]
    scatter[:SHARED, :SHARED] += by_match.T @ by_match
    scatter[range(SHARED), range(SHARED)] += problem.prior.root_precision[:SHARED] ** 2
    return scatter


def _by_drift(problem: SceneProblem, fit: SceneFit, inverse: Floats, shared: float) -> Floats:
    """Half the gradient (size, 2 S) of the cost by the columns, for a shift of the projector's picture at each of S
    stations, of one standard deviation in x and in y.

    The standard deviation is found by moments of the gain of free shifts, as of a random effect (DerSimonian and Laird,
    "Meta-analysis in clinical trials", 1986): `shared` for each by chance.
    """
    scene, observations = fit.scene, problem.observations
    residuals, size = residuals_of(scene, observations, problem.spread), scene.size
    own, _, mixed = residuals.by_points(observations, size)
    count = len(scene.stations)
    across, gradient, information = np.zeros((size, 2 * count)), np.zeros(2 * count), np.zeros((2 * count, 2 * count))
    of_points = np.zeros((len(own), 3, 2 * count))
    root = 1 / (problem.spread.lifted * observations.sigma_px)
    for station in range(count):
        seen = np.flatnonzero(observations.station == station)
        for k in range(2):
            shift, column = np.zeros((len(observations.point), 4)), 2 * station + k
            shift[seen, 2 + k] = -root[seen]
            weighted = residuals.weight * shift
            across[:, column] = residuals.pulls(observations, size, shift).sum(axis=0)
            gradient[column] = np.sum(weighted * residuals.values)
            information[column, column] = np.sum(weighted * shift)
            of_points[..., column] = observations.sums((residuals.across @ shift[..., None])[..., 0])
    following = np.linalg.solve(own, of_points).reshape(-1, 2 * count)
    across -= mixed.reshape(-1, size).T @ following
    information -= of_points.reshape(-1, 2 * count).T @ following
    left = information - across.T @ inverse @ across
    gain = float(gradient @ np.linalg.pinv(left, rcond=_LEAST_SHARE, hermitian=True) @ gradient)
    rank = np.linalg.matrix_rank(left, tol=_LEAST_SHARE * np.linalg.norm(left, 2), hermitian=True)
    drift_px = np.sqrt(max(gain - shared * rank, 0.0) / max(float(np.trace(left)), 1e-300))
    return np.asarray(drift_px * across, np.float64)


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
        ahead, behind = (
            evaluate_after(fit, sign * step, problem.observations, problem.matches, problem.spread, problem.prior)
            for sign in (1, -1)
        )
        slopes = directions.T @ (ahead.gradient - behind.gradient)[free] / 2
        if np.isfinite(slopes).all():
            relative[k] = relative[:, k] = slopes
    shares, axes = np.linalg.eigh(relative)
    axes = directions @ axes
    inverse: Floats = (axes / np.maximum(shares, _LEAST_CURVATURE)) @ axes.T
    return inverse


def _places(scene: RigidScene) -> Ints:
    """The cube (N,) of each point, of the size of some windows of pixels."""
    depth = float(np.median(scene.points[:, 2]))
    size = _PLACE_WINDOWS * np.sqrt(WINDOW_PIXELS) * depth / scene.rig.camera[0]
    cubes = np.floor(scene.points / size).astype(np.int64)
    _, number = np.unique(cubes, axis=0, return_inverse=True)
    return number.reshape(-1)


def _summed(values: Floats, group: Ints) -> Floats:
    """Sums (G, C) of `values` (N, C) by their groups (N,)."""
    total = np.zeros((int(group.max(initial=-1)) + 1, values.shape[1]))
    np.add.at(total, group, values)
    return total
