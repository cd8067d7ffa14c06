"""What is adjusted for a calibration without a corner: bundle adjustment of an unchanged rig over stations of a rigid
scene, its devices, relative pose, stations and points.

Points are eliminated from the normal equations (Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section
6.1).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib.estimation import ROBUST_SIGMAS, Term, add_up
from calib.numerics import NIELSEN, Floats, Quadratic, covariance_of, descend, huber_loss, huber_weights
from calib.refinement import Prior
from calib.scene.residuals import Residuals, missed_at_stations, residuals_of
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


@dataclass(frozen=True, eq=False)
class SceneProblem:
    """What tells of a scene."""

    observations: SceneObservations
    """Of its points."""
    matches: StationMatches
    """Others, which must lie on their epipolar lines."""
    prior: Prior
    """Of the rig."""
    spread: ErrorScales
    """Of observations and matches."""

    def evaluate(self, scene: RigidScene) -> SceneFit:
        """The cost of a scene with its derivatives, points eliminated."""
        residuals, (miss, by_columns) = self.residuals(scene), missed_at_stations(scene, self.matches, self.spread)
        of_points, by_points = self._without_points(residuals)
        of_lines = Term.robust(np.arange(scene.size), miss[:, None], by_columns[:, None])
        total = add_up(scene.size, (*self._known(scene), of_points, of_lines))
        cost = total.cost if np.isfinite(total.cost) else np.inf
        return SceneFit(cost, total.gradient, total.information, scene, residuals.values, miss, by_points)

    def evaluate_after(self, fit: SceneFit, step: Floats) -> SceneFit:
        """The fit after a step of the columns (size,), with points where their rays meet."""
        own, by_step = fit.by_points
        return self.evaluate(self._intersected(fit.scene.moved(step, -own - by_step @ step)))

    def adjust(self, scene: RigidScene, *, steps: int = _STEPS, converged: float = CONVERGED) -> SceneFit:
        """The most likely scene near one, until a step would gain less than `converged` of the cost."""
        return descend(
            self.evaluate(scene),
            self.evaluate_after,
            lambda cost, decrement: decrement < converged * cost,
            _DAMPING,
            steps,
            free=scene.columns.free(self.prior),
            least_gain=converged,
        )

    def covariance(self, fit: SceneFit) -> Floats:
        """The covariance (size, size) by a fit's information; zero where a column is held."""
        return covariance_of(fit.information, fit.scene.columns.free(self.prior))

    def residuals(self, scene: RigidScene) -> Residuals:
        """Those of observations."""
        return residuals_of(scene, self.observations, self.spread)

    def scores_of_matches(self, scene: RigidScene) -> Floats:
        """Half the gradient (L, size) of each match's part of the cost."""
        miss, by_columns = missed_at_stations(scene, self.matches, self.spread)
        return by_columns * (huber_weights(np.abs(miss), ROBUST_SIGMAS) * miss)[:, None]

    def _known(self, scene: RigidScene) -> Iterator[Term]:
        """What is known before: of the rig, and of shifts of the projector's picture."""
        yield Term.of_prior(self.prior, scene.rig.additive())
        if scene.shift_px is not None:
            shifts, root = scene.columns.of_shifts.ravel(), 1 / self.spread.drift_px
            yield Term.gaussian(shifts, root * scene.shift_px.ravel(), root * np.eye(len(shifts)))

    def _without_points(self, residuals: Residuals) -> tuple[Term, tuple[Floats, Floats]]:
        """What observations add to the cost if points follow the columns, and how these do, as in `SceneFit`."""
        size = residuals.columns.size
        cost = float(huber_loss(residuals.lengths, ROBUST_SIGMAS).sum()) + _BEHIND * residuals.behind
        pull, curvature = residuals.by_columns(self.observations)
        own, pull_on_points, mixed = residuals.by_points(self.observations)
        step = np.asarray(np.linalg.solve(own, pull_on_points[..., None])[..., 0], np.float64)
        by_step = np.asarray(np.linalg.solve(own, mixed), np.float64)
        curvature -= mixed.reshape(-1, size).T @ by_step.reshape(-1, size)
        pull -= mixed.reshape(-1, size).T @ step.ravel()
        return Term(cost, pull, curvature, np.arange(size)), (step, by_step)

    def _intersected(self, scene: RigidScene) -> RigidScene:
        """The scene with its points where their rays meet, to second order.

        A long step of the columns moves points along curves. With points that follow, a step succeeds that would fail
        with linear predictions (Jeong et al., "Pushing the envelope of modern methods for bundle adjustment", 2012).
        """
        for _ in range(_POINT_STEPS):
            own, pull = self.residuals(scene).of_points(self.observations)
            step = np.asarray(np.linalg.solve(own, pull[..., None])[..., 0], np.float64)
            scene = replace(scene, points=scene.points - step)
        return scene
