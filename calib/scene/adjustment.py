"""The most likely scene, with the spread of its observations and without outliers; and what its pictures then share."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import MEDIAN_LENGTH, Bools, Floats, robust_sigma
from calib.scene.alignment import align
from calib.scene.drift import measure_drift
from calib.scene.problem import CONVERGED, SceneFit, SceneProblem
from calib.scene.rigid_scene import ErrorScales, RigidScene, SceneObservations
from calib.scene.views import MatchedView, some_matches

FEWEST_STATIONS, FEWEST_POINTS = 3, 20
MATCHES = 3600  # of all stations, beside points that they share
_ANNEALING, _STEPS = (20.0, 5.0, 1.0), 20  # factors on the first guess of the spread, steps with each
GUESS = ErrorScales(0.5, 1.0, 1.0)
_SHARPENED = _ANNEALING, (1.0,)  # each time that pictures and surfaces are aligned
_ROUNDS = 3  # of measuring the spread
_ROUGHLY = 1e-4  # convergence before the last of them
_LEAST_SHARE = 0.5  # of the usual share of observations that are no outliers, of a station in its place
_LEAST_FREEDOM = 0.2  # of an observation, by which its residual is judged
_OUTLYING = 4.0  # sigmas, of an observation that is left out


def solve(problem: SceneProblem, scene: RigidScene, factors: Sequence[float] = _ANNEALING) -> SceneFit:
    """The most likely scene near one, from a wide spread to the guessed one."""
    for factor in factors:
        wide = replace(problem, spread=problem.spread.times(factor))
        fit = wide.adjust(scene, steps=_STEPS, converged=_ROUGHLY)
        scene = fit.scene
    return fit


def refine(problem: SceneProblem, fit: SceneFit, *, drifting: bool = False) -> tuple[SceneProblem, SceneFit]:
    """The problem without outliers and with the spread that residuals show, and its solution.

    `drifting`: shifts of projector pictures are estimated where residuals show some.
    """
    for number in range(1, _ROUNDS + 1):
        growth = _growth(problem, fit)
        within = (np.abs(fit.residual.reshape(-1, 2, 2)).max(axis=2) < _OUTLYING * growth).all(axis=1)
        problem = replace(problem, spread=problem.spread.grown(growth, robust_sigma(fit.miss)))
        problem, scene = _of_observations(problem, within, fit.scene)
        if not len(scene.points):
            return problem, replace(fit, scene=scene)
        if drifting:
            drift_px = measure_drift(problem, scene)
            problem = replace(problem, spread=replace(problem.spread, drift_px=drift_px))
            scene = scene.with_shifts() if drift_px > 0 else replace(scene, shift_px=None)
        fit = problem.adjust(scene, converged=CONVERGED if number == _ROUNDS else _ROUGHLY)
    return problem, fit


def _growth(problem: SceneProblem, fit: SceneFit) -> Floats:
    """Sigmas (2,) of keypoints and of their projector pixels in the units of a fit's residuals.

    A point follows both, in its own way: each is given the degrees of freedom that it has left.
    """
    freedom = problem.residuals(fit.scene).freedom(problem.observations)
    length = np.linalg.norm(fit.residual.reshape(-1, 2, 2), axis=2) / np.sqrt(np.maximum(freedom, _LEAST_FREEDOM) / 2)
    located = problem.observations.is_located
    of_keypoints = np.median(length[located, 0]) if located.any() else MEDIAN_LENGTH  # those of surfaces have none
    medians = np.array([of_keypoints, np.median(length[:, 1])])
    growth: Floats = np.maximum(medians / MEDIAN_LENGTH, 0.1)
    return growth


def _of_observations(problem: SceneProblem, kept: Bools, scene: RigidScene) -> tuple[SceneProblem, RigidScene]:
    """The problem of some observations, and the scene of the points that two of them share."""
    observations = problem.observations
    shared = np.bincount(observations.point[kept], minlength=len(scene.points)) > 1
    chosen = observations[kept & shared[observations.point]]
    number = np.cumsum(shared) - 1
    chosen = replace(chosen, point=number[chosen.point])
    return replace(problem, observations=chosen), replace(scene, points=scene.points[shared])


@dataclass(frozen=True, eq=False)
class Sharpened:
    """The problem of what stations share once they are aligned, with its solution."""

    problem: SceneProblem
    fit: SceneFit
    members: tuple[int, ...]
    """The stations that belong to the scene, by their numbers among those that were given."""


def sharpen(
    problem: SceneProblem, scene: RigidScene, views: Sequence[MatchedView], *, roughly: bool = False
) -> Sharpened | None:
    """The problem of what the stations of a scene share, seen again under each better scene, but for `roughly`.

    `views`: of the stations. Those of which little fits, because they were placed wrongly, are left out. None where too
    little is shared.
    """
    members = tuple(range(len(views)))
    solution, drift_px = None, 0.0
    for factors in _SHARPENED[:1] if roughly else _SHARPENED:
        while True:
            observations, points = align(scene, [views[k] for k in members])
            if len(members) < FEWEST_STATIONS or len(points) < FEWEST_POINTS:
                return solution
            sharper = replace(
                problem,
                observations=observations,
                matches=some_matches([views[k].matches for k in members], MATCHES // len(members)),
                spread=ErrorScales(1.0, 1.0, problem.spread.matches, drift_px),
            )
            begun = solve(sharper, replace(scene, points=points), factors)
            sharper, sharp = refine(sharper, begun, drifting=True)
            drift_px = sharper.spread.drift_px
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
