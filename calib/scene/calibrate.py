"""Stations of a rig that does not change, before anything rigid → its calibration, without a corner or a board."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics import Uncertainty, calibration_of, sigmas_of
from calib.finding import FindingKind
from calib.geometry import Calibration, Matches, Pose, rotation_vector
from calib.numerics import MEDIAN_LENGTH, Bools, Floats, Image, Ints, distinct, robust_sigma
from calib.refinement import (
    CAMERA,
    ORDINARY_LENSES,
    PROJECTOR,
    SHARED,
    Knowledge,
    LensPrior,
    Prior,
    State,
    intrinsic_distance,
)
from calib.refusal import RefusalError
from calib.scene.alignment import align
from calib.scene.bundle import Observations, Scene, SceneFit, Spread, adjust, scores
from calib.scene.start import SceneStart, starts_of, with_motions
from calib.scene.tracks import observe, placed_stations
from calib.scene.views import WINDOW_PIXELS, SceneView, matched_pairs, some_matches, views_of
from calib.self_calibration import PrincipalPoint

_TRIALS = 3  # distinct starts that are followed
_SAME_FOCAL = 0.1  # relative difference below which two trials are one
_MATCHES = 600  # of each station, beside keypoints
_ANNEALING, _STEPS = (20.0, 5.0, 1.0), 20  # factors on the first guess of the spread, steps with each
_GUESS = Spread(0.5, 1.0, 1.0)
_ROUNDS = 3  # of measuring the spread
_SHARPENED = (20.0, 5.0, 1.0), (1.0,)  # as `_ANNEALING`, each time that pictures and surfaces are aligned
_FOLLOWED = 2  # times that a better rig tells which keypoints agree
_OUTLYING = 4.0  # sigmas, of an observation that is left out
_FEWEST_STATIONS, _FEWEST_POINTS = 3, 20
_ONE_AXIS_DEG = 3.0  # rotations all of whose axes are this near to one plane's normal leave a coordinate open
_MOST_FOCAL = 0.015  # relative sigma of a focal length
_AMBIGUOUS_NATS, _DIFFERENT, _SAME_SOLUTION = 8.0, 0.03, 0.005
_RANDOM_PX = 3.0  # how near keypoints are that are matched at random and agree with a motion by chance
_MOST_RESTING = 0.95

TOO_FEW_STATIONS = FindingKind(
    "too-few-stations",
    "Without a corner or a board, fewer than three stations do not determine a calibration.",
    "Take three or more captures: move the rig, or turn and tip what stands before it, by 10 to 30° each time.",
)
NOTHING_MOVED = FindingKind(
    "nothing-moved",
    "The stations of a calibration see the same things at the same places.",
    "Move the rig, or turn and tip what stands before it, by 10 to 30° between the captures.",
)
NO_COMMON_POINTS = FindingKind(
    "no-common-points",
    "The pictures of a calibration's stations have too few points in common.",
    "Move or turn less from one capture to the next, 10 to 30°, and let something with a pattern be in the picture: "
    "books, boxes with print, scraps of newspaper.",
    data=("points", "captures"),
)
ONE_AXIS = FindingKind(
    "turns-about-one-axis",
    "All rotations between the stations of a calibration are about one axis, which leaves the principal points open.",
    "Tip the object once, on its side for instance, or roll the rig once by 20° or more, and take one more capture.",
    data=("axes_deg",),
)
UNDETERMINED = FindingKind(
    "scene-undetermined",
    "The stations of a calibration determine the focal lengths too weakly.",
    "Take more captures, turned about different axes by 10 to 30° each, with more of a pattern in the picture.",
    data=("camera_focal_percent", "projector_focal_percent"),
)
AMBIGUOUS = FindingKind(
    "scene-ambiguous",
    "Two different calibrations explain the stations almost equally well.",
    "Take more captures, turned about different axes by 10 to 30° each.",
    data=("cost", "focal_percent"),
)


@dataclass(frozen=True)
class SceneCalibration:
    """A calibration from stations of an unchanged rig before a rigid scene, in baselines."""

    calibration: Calibration
    uncertainty: Uncertainty
    stations: tuple[int, ...]
    """The numbers of those that share points with others."""
    points: int
    """Points of the scene that two or more stations share."""
    keypoint_px: float
    """Standard deviation of a keypoint in the camera's picture."""


def calibrate_scene(
    captures: Sequence[tuple[Matches, Image]],
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    *,
    principal_point: PrincipalPoint,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
) -> SceneCalibration:
    """Calibrate both devices from captures, each with the lit scene's picture (H, W) or (H, W, 3).

    Raises RefusalError if the captures do not determine a calibration; ValueError if a picture has another size.
    """
    if len(captures) < _FEWEST_STATIONS:
        raise RefusalError(
            TOO_FEW_STATIONS,
            f"{len(captures)} captures without a corner determine no calibration.",
            TOO_FEW_STATIONS.remedy,
        )
    views, resting = views_of(captures, camera_size)
    if resting > _MOST_RESTING:
        raise RefusalError(
            NOTHING_MOVED, f"{resting:.0%} of what the captures see is at the same place in all.", NOTHING_MOVED.remedy
        )
    pairs = matched_pairs(views)
    knowledge = Knowledge(camera_size, projector_size, principal_point.px, principal_point.sigma_px, 0.0, lenses=lenses)
    starts = starts_of(views, pairs, (camera_size, projector_size), np.array(principal_point.px))
    different = distinct(len(starts), lambda k: np.array([_is_near(starts[k], start) for start in starts]), _TRIALS)
    solved: list[_Solution] = []
    for k in different:
        solution = _follow(starts[k], views, pairs, knowledge)
        if solution is not None:
            is_known = any(intrinsic_distance(solution.rig, known.rig)[:2].max() < _SAME_SOLUTION for known in solved)
            solved.append(solution)
            if is_known:
                break
    if not solved:
        raise _nothing_common(0, 0, len(captures))
    solution = max(solved, key=lambda solution: solution.nats)
    best, fit = _sharpened(solution.problem, solution.fit, views)
    if len(fit.scene.points) < _FEWEST_POINTS or len(best.places) < _FEWEST_STATIONS:
        raise _nothing_common(len(fit.scene.points), len(best.places), len(captures))
    _refuse_one_axis(fit.scene.stations)
    covariance = best.covariance(fit)
    sigma = np.sqrt(np.diag(covariance))
    percent = 100 * sigma[CAMERA.start], 100 * sigma[PROJECTOR.start]
    if not max(percent) < 100 * _MOST_FOCAL:
        raise RefusalError(
            UNDETERMINED,
            f"The focal lengths are only known to ± {percent[0]:.1f} % (camera) and ± {percent[1]:.1f} % (projector).",
            UNDETERMINED.remedy,
            {"camera_focal_percent": float(percent[0]), "projector_focal_percent": float(percent[1])},
        )
    _refuse_ambiguous(solution, solved)
    rig = fit.scene.rig
    calibration = calibration_of(rig, camera_size, projector_size, sigmas_of(rig, covariance))
    uncertainty = Uncertainty(rig, covariance, None, best.spread.matches * _usual(best.matches))
    return SceneCalibration(calibration, uncertainty, tuple(best.places), len(fit.scene.points), best.spread.keypoint)


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is adjusted: a start with its observations, other matches, and their spread."""

    start: Scene
    places: Mapping[int, Pose]
    observations: Observations
    matches: Matches
    prior: Prior
    spread: Spread = _GUESS

    def solve(self, factors: Sequence[float] = _ANNEALING) -> SceneFit:
        """The most likely scene near the start, from a wide spread to the guessed one."""
        scene = self.start
        for factor in factors:
            fit = adjust(scene, self.observations, self.matches, self.spread.times(factor), self.prior, _STEPS)
            scene = fit.scene
        return fit

    def refined(self, fit: SceneFit) -> "tuple[_Problem, SceneFit]":
        """The problem without outliers and with the spread that residuals show, and its solution."""
        problem = self
        for _ in range(_ROUNDS):
            growth, of_matches = _growth(fit, problem.observations), robust_sigma(fit.miss)
            within = (np.abs(fit.residual.reshape(-1, 2, 2)).max(axis=2) < _OUTLYING * growth).all(axis=1)
            problem = replace(problem, spread=problem.spread.grown(growth, of_matches))
            problem, scene = problem._of(within, fit.scene)
            if not len(scene.points):
                return problem, replace(fit, scene=scene)
            fit = adjust(scene, problem.observations, problem.matches, problem.spread, problem.prior)
        return problem, fit

    def covariance(self, fit: SceneFit) -> Floats:
        """Of the rig's columns, (21, 21): the mean of what the curvature says and what scores of places say.

        Errors of keypoints have long tails, and points nearby share pixels of the pictures, which the second accounts
        for (White, "Maximum likelihood estimation of misspecified models", 1982; Liang and Zeger, "Longitudinal data
        analysis using generalized linear models", 1986). So does the first, by a factor.
        """
        free = np.concatenate([np.flatnonzero(self.prior.free[:SHARED]), np.arange(SHARED, fit.scene.size)])
        scale = np.sqrt(np.diag(fit.information)[free])
        inverse = np.linalg.pinv(fit.information[np.ix_(free, free)] / np.outer(scale, scale), hermitian=True)
        inverse /= np.outer(scale, scale)
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

    def _of(self, kept: Bools, scene: Scene) -> "tuple[_Problem, Scene]":
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
class _Solution:
    """What a start led to."""

    problem: _Problem
    fit: SceneFit

    @property
    def rig(self) -> State:
        """Devices and their relative pose."""
        return self.fit.scene.rig

    @property
    def nats(self) -> float:
        """Log likelihood of what belongs together over that of keypoints that are matched at random."""
        problem = self.problem
        lifted = problem.spread.lifted * problem.observations.sigma_px
        of_one = 2 * np.log(_RANDOM_PX / problem.spread.keypoint) + 2 * np.log(_RANDOM_PX / lifted)
        return float(of_one.sum())


def _problem(
    start: SceneStart,
    views: Sequence[SceneView],
    pairs: Mapping[tuple[int, int], tuple[Ints, Ints]],
    knowledge: Knowledge,
) -> _Problem | None:
    """None if the start connects too few stations or points."""
    moving = with_motions(start, views, pairs)
    places = placed_stations(moving.motions, len(views))
    if len(places) < _FEWEST_STATIONS:
        return None
    observations, points = observe(moving, views, pairs, places)
    if len(points) < _FEWEST_POINTS:
        return None
    matches = some_matches([views[k] for k in places], _MATCHES)
    scene = Scene(start.rig, tuple(places.values()), points)
    return _Problem(scene, places, observations, matches, knowledge.prior(start.rig))


def _places(scene: Scene) -> Ints:
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


def _sharpened(problem: _Problem, fit: SceneFit, views: Sequence[SceneView]) -> "tuple[_Problem, SceneFit]":
    """The problem of what stations share under its solution, seen again under each better one, and its solution.

    The problem itself where too little is shared.
    """
    placed = [views[k] for k in problem.places]
    for factors in _SHARPENED:
        observations, points = align(fit.scene, placed)
        if len(points) < _FEWEST_POINTS:
            break
        sharper = replace(
            problem,
            start=replace(fit.scene, points=points),
            observations=observations,
            spread=Spread(1.0, 1.0, problem.spread.matches),
        )
        sharper, sharp = sharper.refined(sharper.solve(factors))
        if len(sharp.scene.points) < _FEWEST_POINTS:
            break
        problem, fit = sharper, sharp
    return problem, fit


def _growth(fit: SceneFit, observations: Observations) -> Floats:
    """Sigmas (2,) of keypoints and of their projector pixels in the units of a fit's residuals."""
    located = observations.is_located
    rows = 2 * len(located) + 2 * int(np.count_nonzero(located))
    free = 3 * len(fit.scene.points) - 2 * int(np.count_nonzero(observations.is_chosen)) + fit.scene.size
    left = np.sqrt(max(1 - free / rows, 0.1))
    keypoints, lifted = np.moveaxis(np.linalg.norm(fit.residual.reshape(-1, 2, 2), axis=2), 1, 0)
    medians = np.array([np.median(keypoints[located]), np.median(lifted)])
    growth: Floats = np.maximum(medians / (MEDIAN_LENGTH * left), 0.1)
    return growth


def _follow(
    start: SceneStart,
    views: Sequence[SceneView],
    pairs: Mapping[tuple[int, int], tuple[Ints, Ints]],
    knowledge: Knowledge,
) -> "_Solution | None":
    """What a start leads to; None if it connects too little.

    A better rig shows more of what stations share, and what does not belong together.
    """
    solution = None
    for _ in range(_FOLLOWED):
        problem = _problem(start, views, pairs, knowledge)
        if problem is None:
            break
        problem, fit = problem.refined(problem.solve())
        if len(fit.scene.points) < _FEWEST_POINTS:
            break
        start = with_motions(replace(start, rig=fit.scene.rig), views, pairs)
        solution = _Solution(problem, fit)
    return solution


def _is_near(start: SceneStart, reference: SceneStart) -> bool:
    return bool(intrinsic_distance(start.rig, reference.rig)[:2].max() < _SAME_FOCAL)


def _usual(matches: Matches) -> float:
    return 1.0 if matches.sigma_px is None else float(np.median(matches.sigma_px))


def _nothing_common(points: int, stations: int, captures: int) -> RefusalError:
    return RefusalError(
        NO_COMMON_POINTS,
        f"The pictures of the {captures} captures have too few points in common: {points} in {stations} of them.",
        NO_COMMON_POINTS.remedy,
        {"points": float(points), "captures": float(stations)},
    )


def _refuse_one_axis(stations: Sequence[Pose]) -> None:
    """Raise if the axes of all rotations from the first station are one, as a turntable's are."""
    vectors = rotation_vector(np.stack([pose.rotation for pose in stations[1:]]))
    _, size, _ = np.linalg.svd(vectors)
    off_deg = float(np.degrees(np.arctan2(size[1], size[0]))) if len(size) > 1 else 0.0
    if off_deg < _ONE_AXIS_DEG:
        raise RefusalError(
            ONE_AXIS,
            f"All rotations between the {len(stations)} captures are about one axis, to {off_deg:.1f}°, which leaves "
            "the principal points along it open.",
            ONE_AXIS.remedy,
            {"axes_deg": off_deg},
        )


def _refuse_ambiguous(best: _Solution, solved: Sequence[_Solution]) -> None:
    """Raise if another start led to another calibration that is almost as likely."""
    for rival in solved:
        apart, nats = float(intrinsic_distance(best.rig, rival.rig)[:2].max()), best.nats - rival.nats
        if apart > _DIFFERENT and nats < _AMBIGUOUS_NATS:
            raise RefusalError(
                AMBIGUOUS,
                f"Two calibrations whose focal lengths differ by {apart:.0%} explain the captures almost equally well.",
                AMBIGUOUS.remedy,
                {"cost": 2 * nats, "focal_percent": 100 * apart},
            )
