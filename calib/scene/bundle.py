"""Bundle adjustment of an unchanged rig over stations of a rigid scene: devices, relative pose, stations, points.

A point of the scene is seen by camera and projector of each station that matched it. Its camera pixel has the error of
finding a keypoint; its projector pixel, given that camera pixel, has the decoder's, a tenth of it. All other matches
tell how far the rays of both devices pass each other (Hartley & Zisserman, 2nd ed., chapters 11 and 18). Points are
eliminated from the normal equations (Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6.1).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from calib.geometry import PER_POSE, Matches, Pose, cross_matrix, depths_of_rays
from calib.geometry import radial_distortion as lens
from calib.numerics import NIELSEN, Bools, Floats, Ints, Quadratic, descend, huber_loss, huber_weights
from calib.refinement import CAMERA, PROJECTOR, ROTATION, SHARED, TRANSLATION, Prior, State

HUBER_SIGMAS = 3.0  # sigmas
_ROWS = 4  # of an observation: camera x, y; projector x, y
_STEPS, CONVERGED = 40, 1e-7
_POINT_STEPS = 2  # of points alone, after each step of the columns
# A rig that stations hardly determine has a valley whose curvature is a millionth of the walls'.
_DAMPING = replace(NIELSEN, first=1e-7, least=1e-13)
_BEHIND = 1e4  # cost of an observation behind a device
CHOSEN_PX, ANYWHERE_PX = 1e-3, 1e4  # sigma of a place in a picture that was chosen, and of one that nothing tells


@dataclass(frozen=True, eq=False)
class SceneObservations:
    """Points of the scene in the pictures."""

    point: Ints
    """(M,): numbers of the points, ascending, each at least once."""
    station: Ints
    """(M,): numbers of the stations."""
    camera_px: Floats
    """(M, 2): where the point is in the camera's picture."""
    projector_px: Floats
    """(M, 2): where the projector lights what is at `camera_px`."""
    slope: Floats
    """(M, 2, 2): derivatives of the projector's pixel by the camera's, along the surface."""
    sigma_px: Floats
    """(M,): standard deviation of each coordinate of `projector_px`, for a given camera pixel."""
    keypoint_px: Floats
    """(M,): standard deviation of each coordinate of `camera_px`, before `ErrorScales.keypoint`. A point of a surface
    has `CHOSEN_PX` where it was chosen, and `ANYWHERE_PX` where only the surface is known to contain it."""

    def __getitem__(self, kept: Bools | Ints) -> "SceneObservations":
        return SceneObservations(*(getattr(self, field.name)[kept] for field in fields(self)))

    @property
    def is_located(self) -> Bools:
        """Those (M,) whose place in the camera's picture was found."""
        located: Bools = (self.keypoint_px > CHOSEN_PX) & (self.keypoint_px < ANYWHERE_PX)
        return located

    @property
    def is_chosen(self) -> Bools:
        """Those (M,) where a point of a surface was chosen."""
        chosen: Bools = self.keypoint_px <= CHOSEN_PX
        return chosen

    @classmethod
    def joined(cls, pieces: Sequence["SceneObservations"]) -> "SceneObservations":
        """All of some, ordered by point."""
        every = cls(*(np.concatenate([getattr(piece, field.name) for piece in pieces]) for field in fields(cls)))
        return every[np.argsort(every.point, kind="stable")]

    def sums(self, values: Floats) -> Floats:
        """Sums (N, ...) over the observations of each point of `values` (M, ...)."""
        starts = np.flatnonzero(np.diff(self.point, prepend=-1))
        return np.asarray(np.add.reduceat(values, starts, axis=0), np.float64)


NOTHING_OBSERVED = SceneObservations(
    np.zeros(0, np.int64),
    np.zeros(0, np.int64),
    np.zeros((0, 2)),
    np.zeros((0, 2)),
    np.zeros((0, 2, 2)),
    np.zeros(0),
    np.zeros(0),
)


@dataclass(frozen=True)
class ErrorScales:
    """Factors on the standard deviations: of keypoints, of their projector pixels, and of all matches."""

    keypoint: float
    lifted: float
    matches: float

    def times(self, factor: float) -> "ErrorScales":
        """All of them multiplied."""
        return ErrorScales(factor * self.keypoint, factor * self.lifted, factor * self.matches)

    def grown(self, observed: Floats, matches: float) -> "ErrorScales":
        """Those of keypoints and of their projector pixels multiplied by `observed` (2,), that of all matches, which
        stays above a thousandth, by its own factor.
        """
        keypoint, lifted = observed
        return ErrorScales(
            float(self.keypoint * keypoint), float(self.lifted * lifted), max(self.matches * matches, 1e-3)
        )


@dataclass(frozen=True, eq=False)
class RigidScene:
    """What is estimated: the rig, each station's motion X_station = R X_first + t, and points (N, 3) of the first."""

    rig: State
    stations: tuple[Pose, ...]
    points: Floats

    @property
    def size(self) -> int:
        """Columns without those of points: the rig's, and those of all stations but the first."""
        return SHARED + PER_POSE * (len(self.stations) - 1)

    def of_stations(self, which: Sequence[int]) -> "RigidScene":
        """The scene of some of the stations, in the frame of the first of them."""
        if not which:
            return self
        first = self.stations[which[0]]
        back = first.inverse()
        return RigidScene(self.rig, tuple(self.stations[k] @ back for k in which), first @ self.points)

    def moved(self, step: Floats, by_points: Floats) -> "RigidScene":
        """After a step (size,) and one of the points (N, 3)."""
        stations = [
            pose.retract(step[SHARED + PER_POSE * k : SHARED + PER_POSE * (k + 1)], 1.0)
            for k, pose in enumerate(self.stations[1:])
        ]
        return RigidScene(self.rig.moved(step[:SHARED]), (self.stations[0], *stations), self.points + by_points)


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
    scene: RigidScene, observations: SceneObservations, matches: Matches, spread: ErrorScales, prior: Prior
) -> SceneFit:
    """The cost of a scene with its derivatives, points eliminated."""
    size = scene.size
    values, pull, curvature = prior.misfit(scene.rig.additive())
    cost = float(values.sum())
    gradient, information = np.zeros(size), np.zeros((size, size))
    gradient[:SHARED] += pull
    information[range(SHARED), range(SHARED)] += curvature

    residuals = residuals_of(scene, observations, spread)
    cost += float(huber_loss(residuals.lengths, HUBER_SIGMAS).sum()) + _BEHIND * residuals.behind
    own_pull, own_curvature = residuals.by_columns(observations, size)
    gradient += own_pull
    information += own_curvature
    own, pull_on_points, mixed = residuals.by_points(observations, size)
    step = np.asarray(np.linalg.solve(own, pull_on_points[..., None])[..., 0], np.float64)
    by_step = np.asarray(np.linalg.solve(own, mixed), np.float64)
    information -= mixed.reshape(-1, size).T @ by_step.reshape(-1, size)
    gradient -= mixed.reshape(-1, size).T @ step.ravel()

    miss, by_shared = missed(scene.rig, matches, spread)
    miss_weight = huber_weights(np.abs(miss), HUBER_SIGMAS)
    cost += float(huber_loss(np.abs(miss), HUBER_SIGMAS).sum())
    information[:SHARED, :SHARED] += (by_shared * miss_weight[:, None]).T @ by_shared
    gradient[:SHARED] += (by_shared * miss_weight[:, None]).T @ miss
    return SceneFit(
        cost if np.isfinite(cost) else np.inf, gradient, information, scene, residuals.values, miss, (step, by_step)
    )


def adjust(
    scene: RigidScene,
    observations: SceneObservations,
    matches: Matches,
    spread: ErrorScales,
    prior: Prior,
    *,
    steps: int = _STEPS,
    converged: float = CONVERGED,
) -> SceneFit:
    """The most likely scene near one, until a step would gain less than `converged` of the cost."""
    free = np.concatenate([np.flatnonzero(prior.free[:SHARED]), np.arange(SHARED, scene.size)])

    return descend(
        evaluate(scene, observations, matches, spread, prior),
        lambda fit, step: evaluate_after(fit, step, observations, matches, spread, prior),
        lambda cost, decrement: decrement < converged * cost,
        _DAMPING,
        steps,
        free=free,
        least_gain=converged,
    )


def evaluate_after(
    fit: SceneFit, step: Floats, observations: SceneObservations, matches: Matches, spread: ErrorScales, prior: Prior
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


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of observations with their derivatives, and sums of these."""

    values: Floats
    """(M, 4), in sigmas."""
    by_rig: Floats
    """(M, 4, 21): derivatives by the rig's columns."""
    by_station: Floats
    """(M, 4, 6): derivatives by the motion of the observation's station."""
    by_point: Floats
    """(M, 4, 3): derivatives by its point."""
    behind: int
    """How many are behind a device."""

    @cached_property
    def lengths(self) -> Floats:
        """Those (M, 2) of the keypoint and of its projector pixel."""
        return np.asarray(np.linalg.norm(self.values.reshape(-1, 2, 2), axis=2), np.float64)

    @cached_property
    def weight(self) -> Floats:
        """Huber's, (M, 4)."""
        return np.repeat(huber_weights(self.lengths, HUBER_SIGMAS), 2, axis=1)

    def by_columns(self, observations: SceneObservations, size: int) -> tuple[Floats, Floats]:
        """Half the gradient (size,) and half the curvature (size, size) by the columns."""
        pull, curvature = np.zeros(size), np.zeros((size, size))
        pulls = self.pulls(observations, size)
        pull += pulls.sum(axis=0)
        for columns, own in _of_stations(observations, size):
            rig, station = self.by_rig[own].reshape(-1, SHARED), self.by_station[own].reshape(-1, PER_POSE)
            weighted = rig * self.weight[own].reshape(-1, 1)
            curvature[:SHARED, :SHARED] += weighted.T @ rig
            if columns is not None:
                curvature[:SHARED, columns] = weighted.T @ station
                curvature[columns, :SHARED] = curvature[:SHARED, columns].T
                curvature[columns, columns] = (station * self.weight[own].reshape(-1, 1)).T @ station
        return pull, curvature

    def pulls(self, observations: SceneObservations, size: int, values: Floats | None = None) -> Floats:
        """Half the gradient (N, size) by the columns, of each point's observations, or of other `values` (M, 4)."""
        weighted = (self.weight * (self.values if values is None else values))[:, None]
        pulls = np.zeros((int(observations.point.max(initial=-1)) + 1, size))
        pulls[:, :SHARED] = observations.sums((weighted @ self.by_rig)[:, 0])
        for columns, own in _of_stations(observations, size):
            if columns is not None:
                pulls[observations.point[own], columns] = (weighted[own] @ self.by_station[own])[:, 0]
        return pulls

    @cached_property
    def across(self) -> Floats:
        """Weighted derivatives by points, (M, 3, 4)."""
        return np.swapaxes(self.by_point * self.weight[..., None], 1, 2)

    def of_points(self, observations: SceneObservations) -> tuple[Floats, Floats]:
        """Half the points' own curvature (N, 3, 3), and half the gradient (N, 3)."""
        own = observations.sums(self.across @ self.by_point)
        own += 1e-9 * np.trace(own, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
        return own, observations.sums((self.across @ self.values[..., None])[..., 0])

    def changes(self, observations: SceneObservations, steps: Floats) -> Floats:
        """Changes (M, 4) of the values by a step (N, size) of the columns for each point, which follows its own."""
        own, _, mixed = self.by_points(observations, steps.shape[1])
        of_points = -np.linalg.solve(own, mixed @ steps[..., None])[..., 0]
        by_point = observations.point
        change: Floats = np.einsum("mrc,mc->mr", self.by_rig, steps[by_point, :SHARED])
        change += np.einsum("mrc,mc->mr", self.by_point, of_points[by_point])
        for columns, own_rows in _of_stations(observations, steps.shape[1]):
            if columns is not None:
                moved = steps[by_point[own_rows], columns]
                change[own_rows] += np.einsum("mrc,mc->mr", self.by_station[own_rows], moved)
        return change

    def freedom(self, observations: SceneObservations) -> Floats:
        """2 less the leverage of each keypoint and of its projector pixel on their point, (M, 2)."""
        own, _ = self.of_points(observations)
        spread = np.linalg.solve(own[observations.point], self.across)
        leverage = np.einsum("mri,mir->mr", self.by_point, spread)
        left: Floats = 2 - leverage.reshape(-1, 2, 2).sum(axis=2)
        return left

    def by_points(self, observations: SceneObservations, size: int) -> tuple[Floats, Floats, Floats]:
        """Half the points' own curvature (N, 3, 3), half the gradient (N, 3), and mixed derivatives (N, 3, size)."""
        own, pull = self.of_points(observations)
        across = self.across
        mixed = np.zeros((len(own), 3, size))
        mixed[..., :SHARED] = observations.sums(across @ self.by_rig)
        for columns, of_station in _of_stations(observations, size):
            if columns is not None:
                mixed[observations.point[of_station], :, columns] = across[of_station] @ self.by_station[of_station]
        return own, pull, mixed


def _of_stations(observations: SceneObservations, size: int) -> Iterator[tuple[slice | None, Ints]]:
    """The columns of each station, none of the first's, and its observations, at most one of a point."""
    for number in range(1 + (size - SHARED) // PER_POSE):
        start = SHARED + PER_POSE * (number - 1)
        yield slice(start, start + PER_POSE) if number else None, np.flatnonzero(observations.station == number)


def residuals_of(scene: RigidScene, seen: SceneObservations, spread: ErrorScales) -> Residuals:
    """Those of all observations of a scene."""
    rig, pose = scene.rig, scene.rig.pose
    stations = Pose.stack(scene.stations)[seen.station]
    turned = np.einsum("mij,mj->mi", stations.rotation, scene.points[seen.point])
    at_camera = turned + stations.translation
    at_projector = pose @ at_camera
    behind = ~((at_camera[:, 2] > 0) & (at_projector[:, 2] > 0))
    ahead_camera, ahead_projector = (np.where(behind[:, None], [0.0, 0.0, 1.0], x) for x in (at_camera, at_projector))
    camera_px, by_seen, by_camera = lens.project(rig.camera, ahead_camera)
    projector_px, by_lit, by_projector = lens.project(rig.projector, ahead_projector)
    count = len(seen.point)
    residual, by_rig = np.empty((count, _ROWS)), np.zeros((count, _ROWS, SHARED))
    by_place = np.empty((count, _ROWS, 3))  # in the station's camera frame
    on_camera, slope = camera_px - seen.camera_px, seen.slope
    residual[:, :2] = on_camera
    residual[:, 2:] = projector_px - seen.projector_px - np.einsum("mij,mj->mi", slope, on_camera)
    by_place[:, :2], by_place[:, 2:] = by_seen, by_lit @ pose.rotation - slope @ by_seen
    by_rig[:, :2, CAMERA], by_rig[:, 2:, CAMERA] = by_camera, -slope @ by_camera
    by_rig[:, 2:, PROJECTOR] = by_projector
    by_rig[:, 2:, ROTATION] = -by_lit @ cross_matrix(pose.rotate(ahead_camera))
    by_rig[:, 2:, TRANSLATION] = by_lit @ pose.by_direction
    keypoint_px = np.where(seen.is_located, spread.keypoint, 1.0) * seen.keypoint_px
    sigma = np.stack([keypoint_px] * 2 + [spread.lifted * seen.sigma_px] * 2, axis=1)
    root = np.where(behind[:, None], 0.0, 1 / sigma)
    by_place *= root[..., None]
    by_rig *= root[..., None]
    by_station = np.concatenate([-by_place @ cross_matrix(turned), by_place], axis=2)
    by_point = by_place @ stations.rotation
    return Residuals(root * residual, by_rig, by_station, by_point, int(np.count_nonzero(behind)))


def missed(rig: State, matches: Matches, spread: ErrorScales) -> tuple[Floats, Floats]:
    """Distances (L,) of projector pixels from their epipolar lines, in sigmas, and derivatives (L, 21).

    The point on the camera's ray is the one nearest to the projector's ray; there, the distance is that of pixels,
    perpendicular to the picture of the camera's ray.
    """
    pose = rig.pose
    rays, rays_by_camera = lens.unproject(rig.camera, matches.camera_px)
    lines, _ = lens.unproject(rig.projector, matches.projector_px)
    turned = pose.rotate(rays)
    depth = depths_of_rays(turned, lines, pose.translation)[:, 0]
    places = depth[:, None] * turned + pose.translation
    valid = (depth > 0) & (places[:, 2] > 0) & np.isfinite(depth)
    safe = np.where(valid[:, None], places, [0.0, 0.0, 1.0])
    pixels, by_place, by_projector = lens.project(rig.projector, safe)
    along = np.einsum("lij,lj->li", by_place, turned)
    length = np.linalg.norm(along, axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(length, 1e-12)[:, None]
    by_shared = np.zeros((len(rays), SHARED))

    def project(jacobian: Floats) -> Floats:
        return np.asarray((across[:, None] @ jacobian)[:, 0], np.float64)

    by_shared[:, CAMERA] = project(by_place @ (depth[:, None, None] * (pose.rotation @ rays_by_camera)))
    by_shared[:, PROJECTOR] = project(by_projector)
    by_shared[:, ROTATION] = project(-by_place @ cross_matrix(depth[:, None] * turned))
    by_shared[:, TRANSLATION] = project(by_place @ pose.by_direction)
    sigma = spread.matches * (np.ones(len(rays)) if matches.sigma_px is None else matches.sigma_px)
    miss = np.sum(across * (pixels - matches.projector_px), axis=1) / sigma
    by_shared /= sigma[:, None]
    miss[~valid], by_shared[~valid] = 3 * HUBER_SIGMAS, 0.0
    return miss, by_shared
