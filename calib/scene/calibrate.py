"""Stations of a rig that does not change, before anything rigid → its calibration, without a corner or a board."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics import Uncertainty, calibration_of, sigmas_of
from calib.finding import FindingKind
from calib.geometry import Calibration, Matches, Pose
from calib.numerics import Image, Ints, distinct
from calib.refinement import (
    ORDINARY_LENSES,
    Knowledge,
    LensPrior,
    State,
    device_of,
    intrinsic_distance,
)
from calib.refusal import RefusalError
from calib.scene.adjustment import FEWEST_POINTS, FEWEST_STATIONS, GUESS, MATCHES, refine, sharpen, solve
from calib.scene.covariance import covariance_of_rig
from calib.scene.next_station import NextStation, best_next_station
from calib.scene.problem import SceneFit, SceneProblem
from calib.scene.refusals import (
    AMBIGUOUS,
    NO_COMMON_POINTS,
    NOTHING_MOVED,
    SLIDING,
    TOO_FEW_STATIONS,
    nothing_common,
    refuse_undetermined,
)
from calib.scene.rigid_scene import NOTHING_OBSERVED, RigidScene
from calib.scene.start import SceneStart, starts_of, with_motions
from calib.scene.start_by_shape import ShapeStart, start_by_shape
from calib.scene.tracks import observe, placed_stations
from calib.scene.views import MatchedView, SceneView, matched_pairs, some_matches, views_of, with_keypoints
from calib.self_calibration import PrincipalPoint

_TRIALS = 3  # distinct starts that are followed
_SAME_FOCAL = 0.1  # relative difference below which two trials are one
_FOLLOWED = 2  # times that a better rig tells which keypoints agree
_AMBIGUOUS_NATS, _DIFFERENT, _SAME_SOLUTION = 8.0, 0.03, 0.005
_RANDOM_PX = 3.0  # how near keypoints are that are matched at random and agree with a motion by chance
_MOST_RESTING = 0.95

BY_SCENE = FindingKind(
    "calibrated-by-scene",
    "The rig was calibrated by points that the stations' pictures share, without a corner or a board.",
    "For smaller sigmas take more stations, turned about different axes by 10 to 30° each, or calibrate from a corner.",
    data=("captures", "points", "camera_focal_percent", "projector_focal_percent"),
)


@dataclass(frozen=True, eq=False)
class SceneCalibration:
    """A calibration from stations of an unchanged rig before a rigid scene, in baselines."""

    calibration: Calibration
    uncertainty: Uncertainty
    stations: tuple[int, ...]
    """The numbers of those that share points with others."""
    problem: SceneProblem
    """What was adjusted."""
    fit: SceneFit
    """Its solution."""
    leaves_open: RefusalError | None = None
    """What these stations do not determine, where that was asked for as a start."""

    @property
    def poses(self) -> tuple[Pose, ...]:
        """Of each of the stations, X_station = R X_first + t."""
        return self.fit.scene.stations

    @property
    def points(self) -> int:
        """Points of the scene that two or more stations share."""
        return len(self.fit.scene.points)

    def next_station(self) -> NextStation | None:
        """The turn that would help most; None where points would be out of sight after any."""
        return best_next_station(self.problem, self.fit, self.uncertainty.covariance)


def calibrate_scene(
    captures: Sequence[tuple[Matches, Image]],
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    *,
    principal_point: PrincipalPoint,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
    provisional: bool = False,
) -> SceneCalibration:
    """Calibrate both devices from captures, each with the lit scene's picture (H, W) or (H, W, 3).

    `provisional`: the result is a start of `recalibrate_scene` where stations are missing in it. Then it is rough, and
    says what they leave open instead of refusing it.

    Raises RefusalError if the captures do not determine a calibration; ValueError if a picture has another size.
    """
    if len(captures) < FEWEST_STATIONS:
        raise RefusalError(
            TOO_FEW_STATIONS,
            f"{len(captures)} captures without a corner determine no calibration.",
            TOO_FEW_STATIONS.remedy,
        )
    views = _moving(captures, camera_size)
    knowledge = Knowledge(camera_size, projector_size, principal_point.px, principal_point.sigma_px, 0.0, lenses=lenses)
    solved = _by_keypoints(views, knowledge)
    best = max(solved, key=lambda solution: solution.nats, default=None)
    if best is None or len(best.places) < len(views):
        try:
            placed = _placed_by_shape(views, knowledge)
        except RefusalError:
            if best is None:
                raise
        else:
            if best is None or len(placed.poses) > len(best.places):
                plain = views if solved else [view.without_picture for view in views]
                return _from_placed(placed.rig, placed.poses, plain, knowledge, provisional=provisional)
    ambiguity = _ambiguity(best, solved)
    return _calibrated(
        best.problem, best.fit.scene, best.places, views, knowledge, provisional=provisional, doubt=ambiguity
    )


def _by_keypoints(views: Sequence[MatchedView], knowledge: Knowledge) -> "list[_Solution]":
    """What the best starts lead to; nothing if pictures have too little in common."""
    keypoint_views = [with_keypoints(view) for view in views]
    pairs = matched_pairs(keypoint_views)
    point = knowledge.lenses[1].point
    starts = starts_of(
        keypoint_views,
        pairs,
        (knowledge.camera_size, knowledge.projector_size),
        np.array(knowledge.principal_point_px),
        None if point is None else point.px,
    )
    different = distinct(len(starts), lambda k: np.array([_is_near(starts[k], start) for start in starts]), _TRIALS)
    solved: list[_Solution] = []
    for k in different:
        solution = _follow(starts[k], keypoint_views, pairs, knowledge)
        if solution is not None:
            is_known = any(intrinsic_distance(solution.rig, known.rig)[:2].max() < _SAME_SOLUTION for known in solved)
            solved.append(solution)
            if is_known:
                break
    return solved


def _placed_by_shape(views: Sequence[MatchedView], knowledge: Knowledge) -> ShapeStart:
    """The stations where their surfaces coincide. Raises RefusalError."""
    start = start_by_shape(views, knowledge)
    if start is None:
        raise RefusalError(
            NO_COMMON_POINTS,
            f"The pictures of the {len(views)} captures have too few points in common, and the surfaces of no three of "
            "them fit together under any focal lengths.",
            NO_COMMON_POINTS.remedy,
            {"points": 0.0, "captures": 0.0},
        )
    if start.sliding:
        raise RefusalError(
            SLIDING,
            f"The pictures have too few points in common, and the surfaces of {len(start.sliding)} of the {len(views)} "
            "captures fit the others in more than one way.",
            SLIDING.remedy,
            {"captures": float(len(start.sliding))},
        )
    for rival in start.rivals:
        apart = float(intrinsic_distance(start.rig, rival)[:2].max())
        raise RefusalError(
            AMBIGUOUS,
            f"Surfaces coincide about as well under two calibrations whose focal lengths differ by {apart:.0%}.",
            AMBIGUOUS.remedy,
            {"focal_percent": 100 * apart},
        )
    return start


def recalibrate_scene(
    start: Calibration,
    captures: Sequence[tuple[Matches, Image]],
    stations: Sequence[Pose],
    *,
    principal_point: PrincipalPoint,
    lenses: tuple[LensPrior, LensPrior] = ORDINARY_LENSES,
) -> SceneCalibration:
    """Calibrate both devices from captures whose stations are nearly known, as X_station = R X_any + t, in the start's
    unit.

    Raises RefusalError if the captures do not determine a calibration; ValueError if a picture has another size.
    """
    views = _moving(captures, start.camera.size)
    knowledge = Knowledge(*start.sizes, principal_point.px, principal_point.sigma_px, 0.0, lenses=lenses)
    first = stations[0].inverse()
    motions = [pose @ first for pose in stations]
    poses = {k: Pose(motion.rotation, motion.translation / start.baseline) for k, motion in enumerate(motions)}
    rig = State(device_of(start.camera), device_of(start.projector), start.pose.in_baselines)
    return _from_placed(rig, poses, views, knowledge)


def _from_placed(
    rig: State,
    poses: Mapping[int, Pose],
    views: Sequence[MatchedView],
    knowledge: Knowledge,
    *,
    provisional: bool = False,
) -> SceneCalibration:
    """The calibration near a rig with poses of some of the views, in baselines. Raises RefusalError."""
    rig = knowledge.holding(rig)
    scene = RigidScene(rig, tuple(poses.values()), np.zeros((0, 3)))
    matches = some_matches([views[k].matches for k in poses], MATCHES // len(poses))
    problem = SceneProblem(NOTHING_OBSERVED, matches, knowledge.prior(rig), GUESS)
    return _calibrated(problem, scene, [*poses], views, knowledge, provisional=provisional)


def _calibrated(
    problem: SceneProblem,
    scene: RigidScene,
    places: Sequence[int],
    views: Sequence[MatchedView],
    knowledge: Knowledge,
    *,
    provisional: bool = False,
    doubt: RefusalError | None = None,
) -> SceneCalibration:
    """The calibration near a scene of those of the views that are in `places`. Raises RefusalError, of a `doubt` if
    nothing else is wrong.
    """
    is_rough = provisional and len(places) < len(views)
    sharp = sharpen(problem, scene, [views[k] for k in places], roughly=is_rough)
    if sharp is None:
        raise nothing_common(len(scene.points), len(places), len(views))
    stations = tuple(places[k] for k in sharp.members)
    calibration = _concluded(sharp.problem, sharp.fit, stations, (knowledge.camera_size, knowledge.projector_size))
    try:
        refuse_undetermined(sharp.problem, sharp.fit, calibration.uncertainty)
        if doubt is not None:
            raise doubt
    except RefusalError as refusal:
        if not provisional or len(stations) == len(views):
            raise
        return replace(calibration, leaves_open=refusal)
    return calibration


def _moving(captures: Sequence[tuple[Matches, Image]], camera_size: tuple[int, int]) -> list[MatchedView]:
    """Views of what moved against the rig. Raises RefusalError if nothing did."""
    views, resting = views_of(captures, camera_size)
    if resting > _MOST_RESTING:
        raise RefusalError(
            NOTHING_MOVED, f"{resting:.0%} of what the captures see is at the same place in all.", NOTHING_MOVED.remedy
        )
    return views


def _concluded(
    problem: SceneProblem,
    fit: SceneFit,
    stations: tuple[int, ...],
    sizes: tuple[tuple[int, int], tuple[int, int]],
) -> SceneCalibration:
    rig, covariance = fit.scene.rig, covariance_of_rig(problem, fit)
    calibration = calibration_of(rig, *sizes, sigmas_of(rig, covariance))
    uncertainty = Uncertainty(rig, covariance, None, problem.spread.matches * _usual(problem.matches.matches))
    return SceneCalibration(calibration, uncertainty, stations, problem, fit)


@dataclass(frozen=True, eq=False)
class _Solution:
    """What a start led to."""

    places: tuple[int, ...]
    problem: SceneProblem
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
) -> tuple[SceneProblem, RigidScene, tuple[int, ...]] | None:
    """The problem of a start with its scene and stations; None if it connects too few stations or points."""
    moving = with_motions(start, views, pairs)
    agreeing = {pair: (pose, float(np.count_nonzero(near))) for pair, (pose, near) in moving.motions.items()}
    places = placed_stations(agreeing, len(views))
    if len(places) < FEWEST_STATIONS:
        return None
    observations, points = observe(moving, views, pairs, places)
    if len(points) < FEWEST_POINTS:
        return None
    matches = some_matches([views[k].matches for k in places], MATCHES // len(places))
    scene = RigidScene(start.rig, tuple(places.values()), points)
    return SceneProblem(observations, matches, knowledge.prior(start.rig), GUESS), scene, tuple(places)


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
        begun = _problem(start, views, pairs, knowledge)
        if begun is None:
            break
        problem, scene, places = begun
        problem, fit = refine(problem, solve(problem, scene))
        if len(fit.scene.points) < FEWEST_POINTS:
            break
        start = with_motions(replace(start, rig=fit.scene.rig), views, pairs)
        solution = _Solution(places, problem, fit)
    return solution


def _is_near(start: SceneStart, reference: SceneStart) -> bool:
    return bool(intrinsic_distance(start.rig, reference.rig)[:2].max() < _SAME_FOCAL)


def _usual(matches: Matches) -> float:
    return 1.0 if matches.sigma_px is None else float(np.median(matches.sigma_px))


def _ambiguity(best: _Solution, solved: Sequence[_Solution]) -> RefusalError | None:
    """A refusal if another start led to another calibration that is almost as likely."""
    for rival in solved:
        apart, nats = float(intrinsic_distance(best.rig, rival.rig)[:2].max()), best.nats - rival.nats
        if apart > _DIFFERENT and nats < _AMBIGUOUS_NATS:
            return RefusalError(
                AMBIGUOUS,
                f"Two calibrations whose focal lengths differ by {apart:.0%} explain the captures almost equally well.",
                AMBIGUOUS.remedy,
                {"cost": 2 * nats, "focal_percent": 100 * apart},
            )
    return None
