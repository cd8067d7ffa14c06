"""Stations of a rig that does not change, before anything rigid → its calibration, without a corner or a board."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics import Uncertainty, calibration_of, sigmas_of
from calib.finding import FindingKind
from calib.geometry import Calibration, Matches, Pose, rotation_vector
from calib.numerics import Image, Ints, distinct
from calib.refinement import (
    CAMERA,
    ORDINARY_LENSES,
    PROJECTOR,
    Knowledge,
    LensPrior,
    State,
    device_of,
    intrinsic_distance,
)
from calib.refusal import RefusalError
from calib.scene.bundle import SceneFit
from calib.scene.covariance import covariance_of_rig
from calib.scene.next_station import NextStation, best_next_station
from calib.scene.problem import FEWEST_POINTS, FEWEST_STATIONS, MATCHES, SceneProblem, sharpened
from calib.scene.rigid_scene import NOTHING_OBSERVED, RigidScene
from calib.scene.start import SceneStart, starts_of, with_motions
from calib.scene.tracks import observe, placed_stations
from calib.scene.views import MatchedView, SceneView, matched_pairs, some_matches, views_of, with_keypoints
from calib.self_calibration import PrincipalPoint

_TRIALS = 3  # distinct starts that are followed
_SAME_FOCAL = 0.1  # relative difference below which two trials are one
_FOLLOWED = 2  # times that a better rig tells which keypoints agree
_ONE_AXIS_DEG = 3.0  # rotations that turn by less about all other axes leave a coordinate open
_MOST_FOCAL = 0.015  # relative sigma of a focal length
_AMBIGUOUS_NATS, _DIFFERENT, _SAME_SOLUTION = 8.0, 0.03, 0.005
# Sigmas of a match between a point and the surface that another station sees, each found by 49 of them. Right rigs have
# 0.28 to 0.3 (benchmarks/bench_anything.py), wrong ones that explain the keypoints of three stations 0.5 to 2.
_MOST_APART = 0.8
_RANDOM_PX = 3.0  # how near keypoints are that are matched at random and agree with a motion by chance
_MOST_RESTING = 0.95

BY_SCENE = FindingKind(
    "calibrated-by-scene",
    "The rig was calibrated by points that the stations' pictures share, without a corner or a board.",
    "For smaller sigmas take more stations, turned about different axes by 10 to 30° each, or calibrate from a corner.",
    data=("captures", "points", "camera_focal_percent", "projector_focal_percent"),
)
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
APART = FindingKind(
    "surfaces-bent",
    "Under no calibration do the surfaces that captures share coincide.",
    "Check that nothing of the rig changed between the captures, zoom and focus included, and that what stands before "
    "it kept its shape. Otherwise take more captures, turned less from one to the next.",
    data=("noise_ratio",),
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
    seen = [with_keypoints(view) for view in views]
    pairs = matched_pairs(seen)
    knowledge = Knowledge(camera_size, projector_size, principal_point.px, principal_point.sigma_px, 0.0, lenses=lenses)
    point = lenses[1].point
    starts = starts_of(
        seen, pairs, (camera_size, projector_size), np.array(principal_point.px), None if point is None else point.px
    )
    different = distinct(len(starts), lambda k: np.array([_is_near(starts[k], start) for start in starts]), _TRIALS)
    solved: list[_Solution] = []
    for k in different:
        solution = _follow(starts[k], seen, pairs, knowledge)
        if solution is not None:
            is_known = any(intrinsic_distance(solution.rig, known.rig)[:2].max() < _SAME_SOLUTION for known in solved)
            solved.append(solution)
            if is_known:
                break
    if not solved:
        raise _nothing_common(0, 0, len(captures))
    solution = max(solved, key=lambda solution: solution.nats)
    seen_by = [views[k] for k in solution.places]
    is_rough = provisional and len(seen_by) < len(captures)
    sharp = sharpened(solution.problem, solution.fit.scene, seen_by, roughly=is_rough)
    if sharp is None:
        raise _nothing_common(len(solution.fit.scene.points), len(solution.places), len(captures))
    problem, fit = sharp.problem, sharp.fit
    places = tuple(solution.places[k] for k in sharp.members)
    found = _concluded(problem, fit, places, (camera_size, projector_size))
    try:
        _refuse_undetermined(problem, fit, found.uncertainty)
        _refuse_ambiguous(solution, solved)
    except RefusalError as refusal:
        if not provisional or len(places) == len(captures):
            raise
        return replace(found, leaves_open=refusal)
    return found


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
    poses = tuple(Pose(motion.rotation, motion.translation / start.baseline) for motion in motions)
    rig = knowledge.holding(State(device_of(start.camera), device_of(start.projector), start.pose.in_baselines))
    scene = RigidScene(rig, poses, np.zeros((0, 3)))
    begun = SceneProblem(
        scene,
        NOTHING_OBSERVED,
        some_matches([view.matches for view in views], MATCHES // len(views)),
        knowledge.prior(rig),
    )
    sharp = sharpened(begun, scene, views)
    if sharp is None:
        raise _nothing_common(0, 0, len(captures))
    found = _concluded(sharp.problem, sharp.fit, sharp.members, start.sizes)
    _refuse_undetermined(sharp.problem, sharp.fit, found.uncertainty)
    return found


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


def _refuse_apart(problem: SceneProblem) -> None:
    """Raise if the surfaces of the stations do not coincide: a wrong rig bends each in its own way."""
    if problem.spread.lifted > _MOST_APART:
        raise RefusalError(
            APART,
            f"The surfaces that the captures share are {problem.spread.lifted:.1f} times as far apart as their matches "
            "are noisy, so that no rig explains them.",
            APART.remedy,
            {"noise_ratio": problem.spread.lifted},
        )


def _refuse_undetermined(problem: SceneProblem, fit: SceneFit, uncertainty: Uncertainty) -> None:
    """Raise if surfaces do not coincide, the stations turn about one axis, or focal lengths are known too weakly."""
    _refuse_apart(problem)
    _refuse_one_axis(fit.scene.stations)
    sigma = np.sqrt(np.diag(uncertainty.covariance))
    percent = 100 * sigma[CAMERA.start], 100 * sigma[PROJECTOR.start]
    if not max(percent) < 100 * _MOST_FOCAL:
        raise RefusalError(
            UNDETERMINED,
            f"The focal lengths are only known to ± {percent[0]:.1f} % (camera) and ± {percent[1]:.1f} % (projector).",
            UNDETERMINED.remedy,
            {"camera_focal_percent": float(percent[0]), "projector_focal_percent": float(percent[1])},
        )


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
) -> tuple[SceneProblem, tuple[int, ...]] | None:
    """The problem of a start with its stations; None if it connects too few stations or points."""
    moving = with_motions(start, views, pairs)
    places = placed_stations(moving.motions, len(views))
    if len(places) < FEWEST_STATIONS:
        return None
    observations, points = observe(moving, views, pairs, places)
    if len(points) < FEWEST_POINTS:
        return None
    matches = some_matches([views[k].matches for k in places], MATCHES // len(places))
    scene = RigidScene(start.rig, tuple(places.values()), points)
    return SceneProblem(scene, observations, matches, knowledge.prior(start.rig)), tuple(places)


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
        problem, places = begun
        problem, fit = problem.refined(problem.solve())
        if len(fit.scene.points) < FEWEST_POINTS:
            break
        start = with_motions(replace(start, rig=fit.scene.rig), views, pairs)
        solution = _Solution(places, problem, fit)
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
    """Raise if all rotations from the first station are about one axis, as a turntable's are."""
    vectors = rotation_vector(np.stack([pose.rotation for pose in stations[1:]]))
    axes = np.linalg.svd(vectors)[2]
    off_deg = float(np.degrees(np.linalg.norm(vectors @ axes[1:].T, axis=1).max()))
    if off_deg < _ONE_AXIS_DEG:
        raise RefusalError(
            ONE_AXIS,
            f"All rotations between the {len(stations)} captures are about one axis, but for {off_deg:.1f}°, which "
            "leaves the principal points along it open.",
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
