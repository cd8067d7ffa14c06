"""What is adjusted for a calibration without a corner: a scene with its observations, their spread, and outliers."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import Matches
from calib.numerics import MEDIAN_LENGTH, Bools, Floats, Ints, robust_sigma
from calib.refinement import SHARED, Prior
from calib.scene.alignment import align
from calib.scene.bundle import CONVERGED, ErrorScales, RigidScene, SceneFit, SceneObservations, adjust, scores
from calib.scene.views import WINDOW_PIXELS, MatchedView

FEWEST_STATIONS, FEWEST_POINTS = 3, 20
_ANNEALING, _STEPS = (20.0, 5.0, 1.0), 20  # factors on the first guess of the spread, steps with each
_GUESS = ErrorScales(0.5, 1.0, 1.0)
_SHARPENED = _ANNEALING, (1.0,)  # each time that pictures and surfaces are aligned
_ROUNDS = 3  # of measuring the spread
_ROUGHLY = 1e-4  # convergence before the last of them
_LEAST_SHARE = 0.5  # of the usual share of observations that are no outliers, of a station in its place
_OUTLYING = 4.0  # sigmas, of an observation that is left out


@dataclass(frozen=True, eq=False)
class SceneProblem:
    """What is adjusted."""

    start: RigidScene
    """Where the adjustment begins."""
    observations: SceneObservations
    """Of points of the scene."""
    matches: Matches
    """Others, which must lie on their epipolar lines."""
    prior: Prior
    """Of the rig."""
    spread: ErrorScales = _GUESS
    """Of observations and matches."""

    def solve(self, factors: Sequence[float] = _ANNEALING) -> SceneFit:
        """The most likely scene near the start, from a wide spread to the guessed one."""
        scene = self.start
        for factor in factors:
            fit = adjust(
                scene,
                self.observations,
                self.matches,
                self.spread.times(factor),
                self.prior,
                steps=_STEPS,
                converged=_ROUGHLY,
            )
            scene = fit.scene
        return fit

    def refined(self, fit: SceneFit) -> "tuple[SceneProblem, SceneFit]":
        """The problem without outliers and with the spread that residuals show, and its solution."""
        problem = self
        for number in range(1, _ROUNDS + 1):
            growth, of_matches = _growth(fit, problem.observations), robust_sigma(fit.miss)
            within = (np.abs(fit.residual.reshape(-1, 2, 2)).max(axis=2) < _OUTLYING * growth).all(axis=1)
            problem = replace(problem, spread=problem.spread.grown(growth, of_matches))
            problem, scene = problem._of(within, fit.scene)
            if not len(scene.points):
                return problem, replace(fit, scene=scene)
            converged = CONVERGED if number == _ROUNDS else _ROUGHLY
            fit = adjust(
                scene, problem.observations, problem.matches, problem.spread, problem.prior, converged=converged
            )
        return problem, fit

    def covariance(self, fit: SceneFit) -> Floats:
        """Of the rig's columns, (21, 21): the mean of what the curvature says and what scores of places say.

        Errors of keypoints have long tails, and points nearby share pixels of the pictures, which the second accounts
        for (White, "Maximum likelihood estimation of misspecified models", 1982; Liang and Zeger, "Longitudinal data
        analysis using generalized linear models", 1986). So does the first, by a factor.
        """
        free = self._free(fit.scene.size)
        inverse = self.inverted(fit.information)[np.ix_(free, free)]
        by_point, by_match = scores(fit.scene, self.observations, self.matches, self.spread)
        by_place = _summed(by_point, _places(fit.scene))
        scatter = by_place.T @ by_place
        scatter[:SHARED, :SHARED] += by_match.T @ by_match
        scatter[range(SHARED), range(SHARED)] += self.prior.root_precision[:SHARED] ** 2
        by_scores = inverse @ scatter[np.ix_(free, free)] @ inverse
        shared = max(1.0, float(np.trace(scatter[np.ix_(free, free)] @ inverse)) / len(free))
        covariance = np.zeros((fit.scene.size, fit.scene.size))
        covariance[np.ix_(free, free)] = (shared * inverse + by_scores) / 2
        return covariance[:SHARED, :SHARED]

    def inverted(self, information: Floats) -> Floats:
        """The covariance (size, size) by an information (size, size); zero where a column is held."""
        free = self._free(len(information))
        scale = np.sqrt(np.diag(information)[free])
        inverse = np.linalg.pinv(information[np.ix_(free, free)] / np.outer(scale, scale), hermitian=True)
        covariance = np.zeros_like(information)
        covariance[np.ix_(free, free)] = inverse / np.outer(scale, scale)
        return covariance

    def _free(self, size: int) -> Ints:
        return np.concatenate([np.flatnonzero(self.prior.free[:SHARED]), np.arange(SHARED, size)])

    def _of(self, kept: Bools, scene: RigidScene) -> "tuple[SceneProblem, RigidScene]":
        """The problem of some observations, and the scene of the points that two of them share."""
        seen = self.observations
        shared = np.bincount(seen.point[kept], minlength=len(scene.points)) > 1
        kept = kept & shared[seen.point]
        number = np.cumsum(shared) - 1
        chosen = seen[kept]
        return replace(self, observations=replace(chosen, point=number[chosen.point])), replace(
            scene, points=scene.points[shared]
        )


@dataclass(frozen=True, eq=False)
class Sharpened:
    """The problem of what stations share once they are aligned, with its solution."""

    problem: SceneProblem
    fit: SceneFit
    members: tuple[int, ...]
    """The stations that belong to the scene, by their numbers among those that were given."""


def sharpened(
    problem: SceneProblem, scene: RigidScene, views: Sequence[MatchedView], *, roughly: bool = False
) -> Sharpened | None:
    """The problem of what the stations of a scene share, seen again under each better scene, but for `roughly`.

    `views`: of the stations. Those of which little fits, because they were placed wrongly, are left out. None where too
    little is shared.
    """
    members = tuple(range(len(views)))
    solution = None
    for factors in _SHARPENED[:1] if roughly else _SHARPENED:
        while True:
            observations, points = align(scene, [views[k] for k in members])
            if len(members) < FEWEST_STATIONS or len(points) < FEWEST_POINTS:
                return solution
            sharper = replace(
                problem,
                start=replace(scene, points=points),
                observations=observations,
                spread=ErrorScales(1.0, 1.0, problem.spread.matches),
            )
            sharper, sharp = sharper.refined(sharper.solve(factors))
            if len(sharp.scene.points) < FEWEST_POINTS:
                return solution
            fitting = _fitting(observations, sharper.observations, len(members))
            scene = sharp.scene.of_stations(fitting)
            if len(fitting) == len(members):
                break
            members = tuple(members[k] for k in fitting)
        solution = Sharpened(sharper, sharp, members)
    return solution


def _fitting(observations: SceneObservations, kept: SceneObservations, stations: int) -> list[int]:
    """The stations most of whose observations are no outliers."""
    before, after = (np.bincount(some.station, minlength=stations) for some in (observations, kept))
    share = after / np.maximum(before, 1)
    fits = (after >= FEWEST_POINTS) & (share > _LEAST_SHARE * np.median(share))
    return np.flatnonzero(fits).tolist()


def _places(scene: RigidScene) -> Ints:
    """The cube (N,) of each point, of the size of two windows of pixels."""
    size = 2 * np.sqrt(WINDOW_PIXELS) * float(np.median(scene.points[:, 2])) / scene.rig.camera[0]
    cubes = np.floor(scene.points / size).astype(np.int64)
    _, number = np.unique(cubes, axis=0, return_inverse=True)
    return number.reshape(-1)


def _summed(values: Floats, group: Ints) -> Floats:
    """Sums (G, C) of `values` (N, C) by their groups (N,)."""
    total = np.zeros((int(group.max(initial=-1)) + 1, values.shape[1]))
    np.add.at(total, group, values)
    return total


def _growth(fit: SceneFit, observations: SceneObservations) -> Floats:
    """Sigmas (2,) of keypoints and of their projector pixels in the units of a fit's residuals."""
    located = observations.is_located
    rows = 2 * len(located) + 2 * int(np.count_nonzero(located))
    free = 3 * len(fit.scene.points) - 2 * int(np.count_nonzero(observations.is_chosen)) + fit.scene.size
    left = np.sqrt(max(1 - free / rows, 0.1))
    keypoints, lifted = np.moveaxis(np.linalg.norm(fit.residual.reshape(-1, 2, 2), axis=2), 1, 0)
    medians = np.array([np.median(keypoints[located]), np.median(lifted)])
    growth: Floats = np.maximum(medians / (MEDIAN_LENGTH * left), 0.1)
    return growth
