"""Bundle adjustment of an unchanged rig over stations of a rigid scene: devices, relative pose, stations, points.

A point of the scene is seen by camera and projector of each station that matched it. Its camera pixel has the error of
finding a keypoint; its projector pixel, given that camera pixel, has the decoder's, a tenth of it. All other matches
tell how far the rays of both devices pass each other (Hartley & Zisserman, 2nd ed., chapters 11 and 18). Points are
eliminated from the normal equations (Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6.1).
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import PER_POSE, Matches, Pose, cross_matrix, depths_of_rays
from calib.geometry import radial_distortion as lens
from calib.numerics import NIELSEN, Floats, Ints, Quadratic, descend, huber_loss, huber_weights
from calib.refinement import CAMERA, PROJECTOR, ROTATION, SHARED, TRANSLATION, Prior, State

_ROBUST = 3.0  # sigmas
_ROWS = 4  # of an observation: camera x, y; projector x, y
_STEPS, _CONVERGED = 40, 1e-7
# A rig that stations hardly determine has a valley whose curvature is a millionth of the walls'.
_DAMPING = replace(NIELSEN, first=1e-7, least=1e-13)
_BEHIND = 1e4  # cost of an observation behind a device


@dataclass(frozen=True, eq=False)
class Observations:
    """Points of the scene in the pictures: which `point` (M,), ascending and each at least once, which `station` (M,),
    and where.

    `camera_px`, `projector_px` (M, 2), `slope` (M, 2, 2) and `sigma_px` (M,) as in `SceneView`.
    """

    point: Ints
    station: Ints
    camera_px: Floats
    projector_px: Floats
    slope: Floats
    sigma_px: Floats

    def sums(self, values: Floats) -> Floats:
        """Sums (N, ...) over the observations of each point of `values` (M, ...)."""
        starts = np.flatnonzero(np.diff(self.point, prepend=-1))
        return np.asarray(np.add.reduceat(values, starts, axis=0), np.float64)


@dataclass(frozen=True)
class Spread:
    """Factors on the standard deviations: of keypoints in pixels, of their projector pixels, and of all matches."""

    keypoint_px: float
    lifted: float
    matches: float

    def times(self, factor: float) -> "Spread":
        """All of them multiplied."""
        return Spread(factor * self.keypoint_px, factor * self.lifted, factor * self.matches)

    def grown(self, observed: Floats, matches: float) -> "Spread":
        """Those of keypoints and of their projector pixels multiplied by `observed` (2,), that of all matches, which
        stays above a thousandth, by its own factor.
        """
        keypoint, lifted = observed
        return Spread(
            float(self.keypoint_px * keypoint), float(self.lifted * lifted), max(self.matches * matches, 1e-3)
        )


@dataclass(frozen=True, eq=False)
class Scene:
    """What is estimated: the rig, each station's motion X_station = R X_first + t, and points (N, 3) of the first."""

    rig: State
    stations: tuple[Pose, ...]
    points: Floats

    @property
    def size(self) -> int:
        """Columns without those of points: the rig's, and those of all stations but the first."""
        return SHARED + PER_POSE * (len(self.stations) - 1)

    def moved(self, step: Floats, by_points: Floats) -> "Scene":
        """After a step (size,) and one of the points (N, 3)."""
        stations = [
            pose.retract(step[SHARED + PER_POSE * k : SHARED + PER_POSE * (k + 1)], 1.0)
            for k, pose in enumerate(self.stations[1:])
        ]
        return Scene(self.rig.moved(step[:SHARED]), (self.stations[0], *stations), self.points + by_points)


@dataclass(frozen=True, eq=False)
class SceneFit(Quadratic):
    """A scene with its cost; `gradient` and `information` are those without points.

    `residual` (M, 4) of observations and `miss_px` (L,) of matches from their epipolar lines, both in sigmas.
    """

    scene: Scene
    residual: Floats
    miss: Floats
    by_points: tuple[Floats, Floats]
    """To solve for points: their own step (N, 3), and what a step of the columns changes of it (N, 3, size)."""


def evaluate(scene: Scene, observations: Observations, matches: Matches, spread: Spread, prior: Prior) -> SceneFit:
    """The cost of a scene with its derivatives, points eliminated."""
    size = scene.size
    values, pull, curvature = prior.misfit(scene.rig.additive())
    cost = float(values.sum())
    gradient, information = np.zeros(size), np.zeros((size, size))
    gradient[:SHARED] += pull
    information[range(SHARED), range(SHARED)] += curvature

    residual, by_columns, by_point, behind = _observed(scene, observations, spread)
    weight = np.repeat(_weights(residual), 2, axis=1)
    cost += float(_loss(residual).sum()) + _BEHIND * behind
    weighted = by_columns * weight[..., None]
    flat, flat_weighted = by_columns.reshape(-1, size), weighted.reshape(-1, size)
    information += flat_weighted.T @ flat
    gradient += flat_weighted.T @ residual.ravel()
    across = np.swapaxes(by_point, 1, 2)  # (M, 3, 4)
    own = observations.sums(across @ (by_point * weight[..., None]))
    own_pull = observations.sums((across @ (weight * residual)[..., None])[..., 0])
    mixed = observations.sums(across @ weighted)
    own += 1e-9 * np.trace(own, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-12 * np.eye(3)
    step = np.asarray(np.linalg.solve(own, own_pull[..., None])[..., 0], np.float64)
    by_step = np.asarray(np.linalg.solve(own, mixed), np.float64)
    information -= mixed.reshape(-1, size).T @ by_step.reshape(-1, size)
    gradient -= mixed.reshape(-1, size).T @ step.ravel()

    miss, by_shared = _missed(scene.rig, matches, spread)
    miss_weight = huber_weights(np.abs(miss), _ROBUST)
    cost += float(huber_loss(np.abs(miss), _ROBUST).sum())
    information[:SHARED, :SHARED] += (by_shared * miss_weight[:, None]).T @ by_shared
    gradient[:SHARED] += (by_shared * miss_weight[:, None]).T @ miss
    return SceneFit(
        cost if np.isfinite(cost) else np.inf, gradient, information, scene, residual, miss, (step, by_step)
    )


def adjust(
    scene: Scene, observations: Observations, matches: Matches, spread: Spread, prior: Prior, steps: int = _STEPS
) -> SceneFit:
    """The most likely scene near one."""
    free = np.concatenate([np.flatnonzero(prior.free[:SHARED]), np.arange(SHARED, scene.size)])

    def after(at: SceneFit, step: Floats) -> SceneFit:
        own, by_step = at.by_points
        return evaluate(at.scene.moved(step, -own - by_step @ step), observations, matches, spread, prior)

    start = evaluate(scene, observations, matches, spread, prior)
    return descend(
        start,
        after,
        lambda cost, decrement: decrement < _CONVERGED * cost,
        _DAMPING,
        steps,
        free=free,
        least_gain=_CONVERGED,
    )


def scores(scene: Scene, observations: Observations, matches: Matches, spread: Spread) -> tuple[Floats, Floats]:
    """Half the gradient of the cost of each point (N, size), and of each match (L, 21), at a minimum."""
    residual, by_columns, _, _ = _observed(scene, observations, spread)
    pull = np.repeat(_weights(residual), 2, axis=1) * residual
    by_point = observations.sums((pull[:, None] @ by_columns)[:, 0])
    miss, by_shared = _missed(scene.rig, matches, spread)
    return by_point, by_shared * (huber_weights(np.abs(miss), _ROBUST) * miss)[:, None]


def _weights(residual: Floats) -> Floats:
    """Huber's weights (M, 2) of the keypoint and of its projector pixel."""
    return huber_weights(np.linalg.norm(residual.reshape(-1, 2, 2), axis=2), _ROBUST)


def _loss(residual: Floats) -> Floats:
    return huber_loss(np.linalg.norm(residual.reshape(-1, 2, 2), axis=2), _ROBUST)


def _observed(scene: Scene, seen: Observations, spread: Spread) -> tuple[Floats, Floats, Floats, int]:
    """Residuals (M, 4) in sigmas, their derivatives (M, 4, size) by the columns and (M, 4, 3) by the points, and how
    many are behind a device.
    """
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
    residual, by_columns = np.empty((count, _ROWS)), np.zeros((count, _ROWS, scene.size))
    by_place = np.empty((count, _ROWS, 3))  # in the station's camera frame
    on_camera, slope = camera_px - seen.camera_px, seen.slope
    residual[:, :2] = on_camera
    residual[:, 2:] = projector_px - seen.projector_px - np.einsum("mij,mj->mi", slope, on_camera)
    by_place[:, :2], by_place[:, 2:] = by_seen, by_lit @ pose.rotation - slope @ by_seen
    by_columns[:, :2, CAMERA], by_columns[:, 2:, CAMERA] = by_camera, -slope @ by_camera
    by_columns[:, 2:, PROJECTOR] = by_projector
    by_columns[:, 2:, ROTATION] = -by_lit @ cross_matrix(pose.rotate(ahead_camera))
    by_columns[:, 2:, TRANSLATION] = by_lit @ pose.by_direction
    by_turn = -by_place @ cross_matrix(turned)
    for k in range(1, len(scene.stations)):
        own, start = seen.station == k, SHARED + PER_POSE * (k - 1)
        by_columns[own, :, start : start + 3] = by_turn[own]
        by_columns[own, :, start + 3 : start + PER_POSE] = by_place[own]
    sigma = np.stack([np.full(count, spread.keypoint_px)] * 2 + [spread.lifted * seen.sigma_px] * 2, axis=1)
    by_point = by_place @ stations.rotation
    residual /= sigma
    by_columns /= sigma[..., None]
    by_point = by_point / sigma[..., None]
    residual[behind], by_columns[behind], by_point[behind] = 0.0, 0.0, 0.0
    return residual, by_columns, by_point, int(np.count_nonzero(behind))


def _missed(rig: State, matches: Matches, spread: Spread) -> tuple[Floats, Floats]:
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
    miss[~valid], by_shared[~valid] = 3 * _ROBUST, 0.0
    return miss, by_shared
