"""Residuals of a scene's observations with their derivatives, and of matches whose rays must meet.

A point of the scene is seen by camera and projector of each station that matched it. Its camera pixel has the error of
finding a keypoint; its projector pixel, given that camera pixel, has the decoder's, a tenth of it. All other matches
tell how far the rays of both devices pass each other (Hartley & Zisserman, 2nd ed., chapters 11 and 18).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.estimation import ROBUST_SIGMAS
from calib.geometry import Matches, Pose, cross_matrix, depths_of_rays
from calib.geometry import radial_distortion as lens
from calib.numerics import Floats, Ints, huber_weights
from calib.refinement import CAMERA, PROJECTOR, ROTATION, SHARED, TRANSLATION, State
from calib.scene.rigid_scene import ErrorScales, RigidScene, SceneColumns, SceneObservations, StationMatches

_ROWS = 4  # of an observation: camera x, y; projector x, y


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of observations with their derivatives, and sums of these."""

    values: Floats
    """(M, 4), in sigmas."""
    by_point: Floats
    """(M, 4, 3): derivatives by its point."""
    derive: Callable[[], tuple[Floats, Floats]]
    """Makes `by_rig` and `by_station`, which points alone do without."""
    columns: SceneColumns
    """Those of the scene."""
    behind: int
    """How many are behind a device."""

    @property
    def by_rig(self) -> Floats:
        """(M, 4, 21): derivatives by the rig's columns."""
        return self._derived[0]

    @property
    def by_station(self) -> Floats:
        """(M, 4, 6 or 8): derivatives by the motion of the observation's station and, if estimated, by its shift."""
        return self._derived[1]

    @cached_property
    def _derived(self) -> tuple[Floats, Floats]:
        return self.derive()

    @cached_property
    def lengths(self) -> Floats:
        """Those (M, 2) of the keypoint and of its projector pixel."""
        return np.asarray(np.linalg.norm(self.values.reshape(-1, 2, 2), axis=2), np.float64)

    @cached_property
    def weight(self) -> Floats:
        """Huber's, (M, 4)."""
        return np.repeat(huber_weights(self.lengths, ROBUST_SIGMAS), 2, axis=1)

    def by_columns(self, observations: SceneObservations) -> tuple[Floats, Floats]:
        """Half the gradient (size,) and half the curvature (size, size) by the columns."""
        curvature = np.zeros((self.columns.size,) * 2)
        for columns, by_station, own in self._of_stations(observations):
            rig = self.by_rig[own].reshape(-1, SHARED)
            station = by_station.reshape(len(rig), by_station.shape[2])
            weight = self.weight[own].reshape(-1, 1)
            weighted = rig * weight
            curvature[:SHARED, :SHARED] += weighted.T @ rig
            curvature[:SHARED, columns] = weighted.T @ station
            curvature[columns, :SHARED] = curvature[:SHARED, columns].T
            curvature[columns, columns] = (station * weight).T @ station
        return self.pulls(observations).sum(axis=0), curvature

    def pulls(self, observations: SceneObservations, values: Floats | None = None) -> Floats:
        """Half the gradient (N, size) by the columns, of each point's observations, or of other `values` (M, 4)."""
        weighted = (self.weight * (self.values if values is None else values))[:, None]
        pulls = np.zeros((int(observations.point.max(initial=-1)) + 1, self.columns.size))
        pulls[:, :SHARED] = observations.sums((weighted @ self.by_rig)[:, 0])
        for columns, by_station, own in self._of_stations(observations):
            pulls[observations.point[own], columns] = (weighted[own] @ by_station)[:, 0]
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
        own, _, mixed = self.by_points(observations)
        of_points = -np.linalg.solve(own, mixed @ steps[..., None])[..., 0]
        by_point = observations.point
        change: Floats = np.einsum("mrc,mc->mr", self.by_rig, steps[by_point, :SHARED])
        change += np.einsum("mrc,mc->mr", self.by_point, of_points[by_point])
        for columns, by_station, own_rows in self._of_stations(observations):
            change[own_rows] += np.einsum("mrc,mc->mr", by_station, steps[by_point[own_rows], columns])
        return change

    def freedom(self, observations: SceneObservations) -> Floats:
        """2 less the leverage of each keypoint and of its projector pixel on their point, (M, 2)."""
        own, _ = self.of_points(observations)
        spread = np.linalg.solve(own[observations.point], self.across)
        leverage = np.einsum("mri,mir->mr", self.by_point, spread)
        freedom: Floats = 2 - leverage.reshape(-1, 2, 2).sum(axis=2)
        return freedom

    def by_points(self, observations: SceneObservations) -> tuple[Floats, Floats, Floats]:
        """Half the points' own curvature (N, 3, 3), half the gradient (N, 3), and mixed derivatives (N, 3, size)."""
        own, pull = self.of_points(observations)
        across = self.across
        mixed = np.zeros((len(own), 3, self.columns.size))
        mixed[..., :SHARED] = observations.sums(across @ self.by_rig)
        for columns, by_station, of_station in self._of_stations(observations):
            mixed[observations.point[of_station], :, columns] = across[of_station] @ by_station
        return own, pull, mixed

    def scores(self, observations: SceneObservations) -> Floats:
        """Half the gradient (N, size) of each point's part of the cost, which the point follows."""
        own, pull_on_points, mixed = self.by_points(observations)
        followed = np.linalg.solve(own, pull_on_points[..., None])
        return self.pulls(observations) - (np.swapaxes(followed, 1, 2) @ mixed)[:, 0]

    def _of_stations(self, observations: SceneObservations) -> Iterator[tuple[slice, Floats, Ints]]:
        """The columns of each station, derivatives by them, and its observations, at most one of a point."""
        for number in range(self.columns.stations):
            columns, of_station = self.columns.of_station(number)
            own = np.flatnonzero(observations.station == number)
            yield columns, self.by_station[own][..., of_station], own


def residuals_of(scene: RigidScene, observations: SceneObservations, spread: ErrorScales) -> Residuals:
    """Those of all observations of a scene."""
    rig, pose = scene.rig, scene.rig.pose
    stations = Pose.stack(scene.stations)[observations.station]
    turned = np.einsum("mij,mj->mi", stations.rotation, scene.points[observations.point])
    at_camera = turned + stations.translation
    at_projector = pose @ at_camera
    behind = ~((at_camera[:, 2] > 0) & (at_projector[:, 2] > 0))
    ahead_camera, ahead_projector = (np.where(behind[:, None], [0.0, 0.0, 1.0], x) for x in (at_camera, at_projector))
    camera_px, by_seen, by_camera = lens.project(rig.camera, ahead_camera)
    projector_px, by_lit, by_projector = lens.project(rig.projector, ahead_projector)
    residual = np.empty((len(observations.point), _ROWS))
    by_place = np.empty((len(residual), _ROWS, 3))  # in the station's camera frame
    on_camera, slope = camera_px - observations.camera_px, observations.slope
    residual[:, :2] = on_camera
    if scene.shift_px is not None:
        projector_px = projector_px + scene.shift_px[observations.station]
    residual[:, 2:] = projector_px - observations.projector_px - np.einsum("mij,mj->mi", slope, on_camera)
    by_place[:, :2], by_place[:, 2:] = by_seen, by_lit @ pose.rotation - slope @ by_seen
    keypoint_px = np.where(observations.is_located, spread.keypoint, 1.0) * observations.keypoint_px
    sigma = np.stack([keypoint_px] * 2 + [spread.lifted * observations.sigma_px] * 2, axis=1)
    root = np.where(behind[:, None], 0.0, 1 / sigma)
    by_place *= root[..., None]

    def derive() -> tuple[Floats, Floats]:
        by_rig = np.zeros((len(residual), _ROWS, SHARED))
        by_rig[:, :2, CAMERA], by_rig[:, 2:, CAMERA] = by_camera, -slope @ by_camera
        by_rig[:, 2:, PROJECTOR] = by_projector
        by_rig[:, 2:, ROTATION] = -by_lit @ cross_matrix(pose.rotate(ahead_camera))
        by_rig[:, 2:, TRANSLATION] = by_lit @ pose.by_direction
        by_rig *= root[..., None]
        by_station = [-by_place @ cross_matrix(turned), by_place]
        if scene.shift_px is not None:
            by_station.append(root[..., None] * np.eye(_ROWS)[:, 2:])
        return by_rig, np.concatenate(by_station, axis=2)

    by_point = by_place @ stations.rotation
    return Residuals(root * residual, by_point, derive, scene.columns, int(np.count_nonzero(behind)))


def missed(rig: State, matches: Matches, scale: float) -> tuple[Floats, Floats, Floats]:
    """Distances (L,) of projector pixels from their epipolar lines, in sigmas times `scale`, and derivatives by the
    rig's columns (L, 21) and by a shift of the projected pixels (L, 2).

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
    sigma = scale * (np.ones(len(rays)) if matches.sigma_px is None else matches.sigma_px)
    miss = np.sum(across * (pixels - matches.projector_px), axis=1) / sigma
    by_shared /= sigma[:, None]
    by_shift = across / sigma[:, None]
    miss[~valid], by_shared[~valid], by_shift[~valid] = 3 * ROBUST_SIGMAS, 0.0, 0.0
    return miss, by_shared, by_shift


def missed_at_stations(
    scene: RigidScene, station_matches: StationMatches, spread: ErrorScales
) -> tuple[Floats, Floats]:
    """Distances (L,) of stations' projector pixels from their epipolar lines, in sigmas, and derivatives (L, size)."""
    matches = station_matches.matches
    if scene.shift_px is not None:
        matches = replace(matches, projector_px=matches.projector_px - scene.shift_px[station_matches.station])
    miss, by_shared, by_shift = missed(scene.rig, matches, spread.matches)
    by_columns = np.zeros((len(miss), scene.size))
    by_columns[:, :SHARED] = by_shared
    if scene.shift_px is not None:
        by_columns[np.arange(len(miss))[:, None], scene.columns.of_shifts[station_matches.station]] = by_shift
    return miss, by_columns
