"""Bundle adjustment of an unchanged rig over stations of a rigid scene: devices, relative pose, stations, points.

Points are eliminated from the normal equations (Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section
6.1).
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import NIELSEN, Floats, Quadratic, descend, huber_loss, huber_weights
from calib.refinement import SHARED, Prior
from calib.scene.residuals import HUBER_SIGMAS, missed_at_stations, residuals_of
from calib.scene.rigid_scene import ErrorScales, RigidScene, SceneObservations, StationMatches

_STEPS, CONVERGED = 40, 1e-7
_POINT_STEPS = 2  # of points alone, after each step of the columns
# A rig that stations hardly determine has a valley whose curvature is a millionth of the walls'.
_DAMPING = replace(NIELSEN, first=1e-7, least=1e-13)
_BEHIND = 1e4  # cost of an observation behind a device


@dataclass(frozen=True, eq=False)
class SceneFit(Quadratic):
    """A scene with its cost; `gradient` and `information` are those without points.

    `residual` (M, 4) of observations and `miss_px` (L,) of matches from their epipolar lines, both in sigmas.
    """

    scene: RigidScene
    residual: Floats
    miss: Floats
    by_points: tuple[Floats, Floats]
    """To solve for points: their own step (N, 3), and what a step of the columns changes of it (N, 3, size)."""


def evaluate(
    scene: RigidScene, observations: SceneObservations, matches: StationMatches, spread: ErrorScales, prior: Prior
) -> SceneFit:
    """The cost of a scene with its derivatives, points eliminated."""
    size = scene.size
    values, pull, curvature = prior.misfit(scene.rig.additive())
    cost = float(values.sum())
    gradient, information = np.zeros(size), np.zeros((size, size))
    gradient[:SHARED] += pull
    information[range(SHARED), range(SHARED)] += curvature
    if scene.shift_px is not None:
        shifts, precision = scene.columns.of_shifts, spread.drift_px**-2
        cost += precision * float(np.sum(scene.shift_px**2))
        gradient[shifts] += precision * scene.shift_px
        information[shifts, shifts] += precision

    residuals = residuals_of(scene, observations, spread)
    cost += float(huber_loss(residuals.lengths, HUBER_SIGMAS).sum()) + _BEHIND * residuals.behind
    own_pull, own_curvature = residuals.by_columns(observations)
    gradient += own_pull
    information += own_curvature
    own, pull_on_points, mixed = residuals.by_points(observations)
    step = np.asarray(np.linalg.solve(own, pull_on_points[..., None])[..., 0], np.float64)
    by_step = np.asarray(np.linalg.solve(own, mixed), np.float64)
    information -= mixed.reshape(-1, size).T @ by_step.reshape(-1, size)
    gradient -= mixed.reshape(-1, size).T @ step.ravel()

    miss, by_columns = missed_at_stations(scene, matches, spread)
    miss_weight = huber_weights(np.abs(miss), HUBER_SIGMAS)
    cost += float(huber_loss(np.abs(miss), HUBER_SIGMAS).sum())
    information += (by_columns * miss_weight[:, None]).T @ by_columns
    gradient += (by_columns * miss_weight[:, None]).T @ miss
    return SceneFit(
        cost if np.isfinite(cost) else np.inf, gradient, information, scene, residuals.values, miss, (step, by_step)
    )


def adjust(
    scene: RigidScene,
    observations: SceneObservations,
    matches: StationMatches,
    spread: ErrorScales,
    prior: Prior,
    *,
    steps: int = _STEPS,
    converged: float = CONVERGED,
) -> SceneFit:
    """The most likely scene near one, until a step would gain less than `converged` of the cost."""
    return descend(
        evaluate(scene, observations, matches, spread, prior),
        lambda fit, step: evaluate_after(fit, step, observations, matches, spread, prior),
        lambda cost, decrement: decrement < converged * cost,
        _DAMPING,
        steps,
        free=scene.columns.free(prior),
        least_gain=converged,
    )


def evaluate_after(
    fit: SceneFit,
    step: Floats,
    observations: SceneObservations,
    matches: StationMatches,
    spread: ErrorScales,
    prior: Prior,
) -> SceneFit:
    """The fit after a step of the columns (size,), with points where their rays meet."""
    own, by_step = fit.by_points
    moved = fit.scene.moved(step, -own - by_step @ step)
    return evaluate(_intersected(moved, observations, spread), observations, matches, spread, prior)


def _intersected(scene: RigidScene, observations: SceneObservations, spread: ErrorScales) -> RigidScene:
    """The scene with its points where their rays meet, to second order.

    A long step of the columns moves points along curves. With points that follow, a step succeeds that would fail with
    linear predictions (Jeong et al., "Pushing the envelope of modern methods for bundle adjustment", 2012).
    """
    for _ in range(_POINT_STEPS):
        residuals = residuals_of(scene, observations, spread)
        own, pull = residuals.of_points(observations)
        step = np.asarray(np.linalg.solve(own, pull[..., None])[..., 0], np.float64)
        scene = replace(scene, points=scene.points - step)
    return scene
