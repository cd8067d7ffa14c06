"""The true parameters of a rig before corners, what they predict of each match, and the exact derivatives.

A camera pixel is unprojected, its ray meets the plane that it is on, and the point is projected into the projector.
Lengths are in baselines: |translation| = 1. Both lenses have two radial terms.

Columns of every step, gradient and Hessian: camera log f, x_0, y_0, k1, k2; the same for the projector; rotation (3);
direction of the translation (2); three angles off square for each corner; then, for each pose of a corner, its rotation
(3), its vertex (3, as a share of its distance), and for each further plane two tilts and its height; then, for each
further photo, its rotation (3), the direction of its translation (2) and the logarithm of that one's length.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from calib import lens
from calib.arrays import Floats, Ints
from calib.homography import FACES
from calib.motion import Motion, cross, tangent_basis

CAMERA, PROJECTOR = slice(0, 5), slice(5, 10)
ROTATION, TRANSLATION = slice(10, 13), slice(13, 15)
SHARED = 15
PER_CORNER, PER_POSE, PER_PLANE, PER_MOTION = 3, 6, 3, 6

# (face, face) of each angle: angle 0 is between the faces 1 and 2, and so on round.
_PAIRS = ((1, 2), (2, 0), (0, 1))


@dataclass(frozen=True)
class FurtherPlane:
    """A plane that is parallel or perpendicular to a face, roughly.

    `axes` (3, 3): unit rows in the coordinates of the corner's frame, the plane's normal and two directions to tilt
    it towards; `tilt` (2,) small; `height`: how far the corner's vertex is behind the plane, in baselines.
    """

    axes: Floats
    tilt: Floats
    height: float
    tilt_sigma: tuple[float, float]


@dataclass(frozen=True)
class Pose:
    """Where a corner is in one capture: `frame` (3, 3), unit rows along the legs; `vertex` (3,); camera's frame.

    `corner` says which of the state's corners it is. `planes` are seen beside its three faces.
    """

    frame: Floats
    vertex: Floats
    corner: int = 0
    planes: tuple[FurtherPlane, ...] = ()

    @property
    def size(self) -> int:
        """Number of columns."""
        return PER_POSE + PER_PLANE * len(self.planes)


@dataclass(frozen=True)
class State:
    """`camera`, `projector`: (5,) f, x_0, y_0, k1, k2. `rotation` (3, 3), `translation` (3,) of unit length.

    `off_square` (G, 3): for each corner the angles in radians by which the faces (B, C), (C, A), (A, B) are off square.
    `one_camera`: the second device is the first at another place. The camera's columns then move both, and those of the
    projector say nothing. There is one pose, that of the corner before the first photo. Capture 0 pairs it with a
    second photo, capture 1 and up with one of the `further` photos each.
    """

    camera: Floats
    projector: Floats
    rotation: Floats
    translation: Floats
    off_square: Floats
    poses: tuple[Pose, ...]
    one_camera: bool = False
    further: tuple[Motion, ...] = ()

    @property
    def size(self) -> int:
        """Number of columns."""
        return self._starts[-1] + PER_MOTION * len(self.further)

    @cached_property
    def _starts(self) -> tuple[int, ...]:
        """First column of each pose, and the column behind the last pose."""
        starts = [SHARED + PER_CORNER * len(self.off_square)]
        for pose in self.poses:
            starts.append(starts[-1] + pose.size)
        return tuple(starts)

    def angle_columns(self, corner: int) -> slice:
        """Columns of a corner's angles."""
        return slice(SHARED + PER_CORNER * corner, SHARED + PER_CORNER * (corner + 1))

    def pose(self, capture: int) -> Pose:
        """Where the corner is in a capture."""
        return self.poses[0 if self.one_camera else capture]

    def pose_columns(self, capture: int) -> slice:
        """Columns of a capture's pose and further planes."""
        pose = 0 if self.one_camera else capture
        return slice(self._starts[pose], self._starts[pose + 1])

    def motion(self, capture: int) -> Motion:
        """From the camera to the second device of a capture."""
        if self.one_camera and capture:
            return self.further[capture - 1]
        return Motion(self.rotation, self.translation)

    def motion_columns(self, capture: int) -> Ints:
        """Columns of a capture's motion: rotation (3), direction (2), and with further photos the length."""
        if not (self.one_camera and capture):
            return np.arange(ROTATION.start, TRANSLATION.stop, dtype=np.int32)
        start = self._starts[-1] + PER_MOTION * (capture - 1)
        return np.arange(start, start + PER_MOTION, dtype=np.int32)

    def columns(self, capture: int) -> Ints:
        """The columns that a capture depends on, in the order of `predict`'s Jacobian."""
        places, motion = np.arange(self.size, dtype=np.int32), self.motion_columns(capture)
        return np.concatenate(
            [
                places[: ROTATION.start],
                motion[:5],
                places[self.angle_columns(self.pose(capture).corner)],
                places[self.pose_columns(capture)],
                motion[5:],
            ]
        )

    def moved(self, step: Floats) -> "State":
        """The state after a step (size,) in the columns' coordinates."""
        motion = self.motion(0).moved(step[self.motion_columns(0)])
        camera = _moved_device(self.camera, step[CAMERA])
        return replace(
            self,
            camera=camera,
            projector=camera if self.one_camera else _moved_device(self.projector, step[PROJECTOR]),
            rotation=motion.rotation,
            translation=motion.translation,
            off_square=self.off_square + step[SHARED : self._starts[0]].reshape(-1, PER_CORNER),
            poses=tuple(_moved_pose(pose, step[self.pose_columns(i)]) for i, pose in enumerate(self.poses)),
            further=tuple(each.moved(step[self.motion_columns(i)]) for i, each in enumerate(self.further, start=1)),
        )

    def step_to(self, other: "State") -> Floats:
        """The step (size,) from here to a state of the same layout not too far away."""
        step = other.additive() - self.additive()
        for i in range(1 + len(self.further)):
            columns = self.motion_columns(i)
            step[columns] = self.motion(i).step_to(other.motion(i))[: len(columns)]
        for i, (pose, there) in enumerate(zip(self.poses, other.poses, strict=True)):
            part = step[self.pose_columns(i)]
            part[:3] = Rotation.from_matrix(there.frame.T @ pose.frame).as_rotvec()
            part[3:PER_POSE] = (there.vertex - pose.vertex) / np.linalg.norm(pose.vertex)
            part[PER_POSE + 2 :: PER_PLANE] = [
                b.height - a.height for a, b in zip(pose.planes, there.planes, strict=True)
            ]
        return step

    def additive(self) -> Floats:
        """The columns that may have a prior, as numbers that a step adds to, (size,); zero for rotations and such."""
        values = np.zeros(self.size)
        for columns, device in ((CAMERA, self.camera), (PROJECTOR, self.projector)):
            values[columns] = np.concatenate([[np.log(device[0])], device[1:]])
        values[SHARED : self._starts[0]] = self.off_square.ravel()
        for i, pose in enumerate(self.poses):
            for j, plane in enumerate(pose.planes):
                start = self._starts[i] + PER_POSE + PER_PLANE * j
                values[start : start + 2] = plane.tilt
        return values

    @property
    def followed(self) -> Ints:
        """For each column the one that it moves with, (size,): itself, unless both devices are one camera."""
        followed = np.arange(self.size, dtype=np.int32)
        if self.one_camera:
            followed[PROJECTOR] = followed[CAMERA]
        return followed

    def normals(self, capture: int = 0) -> Floats:
        """Unit normals of the faces in the camera's frame, (3, 3) rows."""
        pose = self.pose(capture)
        mixing = _mixing(self.off_square[pose.corner])
        unit: Floats = mixing / np.linalg.norm(mixing, axis=1, keepdims=True) @ pose.frame
        return unit

    def legs(self, capture: int = 0) -> Floats:
        """Unit directions of the edges in the camera's frame, (3, 3) rows."""
        normals = self.normals(capture)
        legs = np.cross(np.roll(normals, -1, axis=0), np.roll(normals, -2, axis=0))
        legs *= np.sign(np.sum(legs * normals, axis=1))[:, None]
        unit: Floats = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        return unit


def intrinsic_distance(a: State, b: State) -> Floats:
    """(4,): differences of the logarithms of both focals, and of the projector's centre in its focals; not negative."""
    focals = np.log([a.camera[0] / b.camera[0], a.projector[0] / b.projector[0]])
    centre = (a.projector[1:3] - b.projector[1:3]) / b.projector[0]
    distance: Floats = np.abs(np.concatenate([focals, centre]))
    return distance


def predict(state: State, camera_px: Floats, plane: Ints, capture: int = 0) -> tuple[Floats, Floats, Floats]:
    """Where matches at camera pixels (N, 2) on planes (N,) of a capture fall in the projector, with derivatives.

    Planes 0, 1, 2 are the corner's faces, 3 and up the pose's further planes. Returns projector pixels (N, 2), the
    Jacobian (N, 2, columns) by `state.columns(capture)`, and depths (N, 2) in both devices (not positive where the
    prediction means nothing).
    """
    pose, motion = state.pose(capture), state.motion(capture)
    rays, rays_by_camera = lens.unproject(state.camera, camera_px)
    every_normal, every_height = _planes(state, capture)
    normals, heights = every_normal[plane], every_height[plane]
    facing = np.sum(normals * rays, axis=1)
    depth = (np.sum(normals * pose.vertex, axis=1) + heights) / facing
    points = depth[:, None] * rays

    # d(point) = depth (dr − r n·dr / n·r) + r / (n·r) (dn·(vertex − point) + n·dvertex + dheight)
    to_vertex = pose.vertex - points
    along = rays / facing[:, None]
    turned = points @ motion.rotation.T
    moved = turned + motion.translation
    pixels, by_moved, by_projector = lens.project(state.projector, moved)

    by_point = by_moved @ motion.rotation
    by_depth = np.einsum("nij,nj->ni", by_point, along)
    jacobian = np.zeros((len(plane), 2, len(state.columns(capture))))
    facing_by_camera = np.einsum("ni,nij->nj", normals, rays_by_camera)
    jacobian[:, :, CAMERA] = by_point[:, :, :2] @ rays_by_camera[:, :2]  # the third coordinate of a ray is 1
    jacobian[:, :, CAMERA] -= by_depth[:, :, None] * facing_by_camera[:, None, :]
    jacobian[:, :, CAMERA] *= depth[:, None, None]
    jacobian[:, :, PROJECTOR] = by_projector
    # d(R X) = ω × R X, so each row g of by_moved gives g · (ω × RX) = ω · (RX × g).
    jacobian[:, :, ROTATION] = cross(turned[:, None, :], by_moved)
    jacobian[:, :, TRANSLATION] = by_moved @ tangent_basis(motion.translation / motion.length) * motion.length
    on_plane = np.concatenate(
        [
            np.einsum("nai,ni->na", _normals_by_angles(state, capture)[plane], to_vertex),
            cross(normals, to_vertex),
            normals * np.linalg.norm(pose.vertex),
            *_by_further_planes(pose, plane, to_vertex),
        ],
        axis=1,
    )
    jacobian[:, :, SHARED : SHARED + on_plane.shape[1]] = by_depth[:, :, None] * on_plane[:, None, :]
    jacobian[:, :, SHARED + on_plane.shape[1] :] = (by_moved @ motion.translation)[:, :, None]
    if state.one_camera:
        jacobian[:, :, CAMERA] += jacobian[:, :, PROJECTOR]
        jacobian[:, :, PROJECTOR] = 0.0
    return pixels, jacobian, np.stack([depth, moved[:, 2]], axis=1)


def _planes(state: State, capture: int) -> tuple[Floats, Floats]:
    """Unit normals (P, 3) of faces and further planes in the camera's frame, and their heights (P,)."""
    pose = state.pose(capture)
    further = [_tilted(plane) / np.linalg.norm(_tilted(plane)) @ pose.frame for plane in pose.planes]
    normals = np.concatenate([state.normals(capture), np.reshape(further, (-1, 3))])
    return normals, np.array([0.0] * len(FACES) + [plane.height for plane in pose.planes])


def _tilted(plane: FurtherPlane) -> Floats:
    tilted: Floats = plane.axes[0] + plane.tilt @ plane.axes[1:]
    return tilted


def _by_further_planes(pose: Pose, plane: Ints, to_vertex: Floats) -> list[Floats]:
    """For each further plane (N, 3): how n·(vertex − point) + height changes with its tilts and its height."""
    changes = []
    for i, further in enumerate(pose.planes):
        tilted = _tilted(further)
        length = np.linalg.norm(tilted)
        unit = tilted / length
        by_tilt = (further.axes[1:] - np.outer(further.axes[1:] @ unit, unit)) / length @ pose.frame
        change = np.concatenate([to_vertex @ by_tilt.T, np.ones((len(plane), 1))], axis=1)
        changes.append(np.where((plane == len(FACES) + i)[:, None], change, 0.0))
    return changes


def _moved_device(device: Floats, step: Floats) -> Floats:
    return np.concatenate([[device[0] * np.exp(step[0])], device[1:] + step[1:]])


def _moved_pose(pose: Pose, step: Floats) -> Pose:
    turned = pose.frame @ Rotation.from_rotvec(step[:3]).as_matrix().T
    planes = tuple(
        replace(plane, tilt=plane.tilt + part[:2], height=plane.height + float(part[2]))
        for plane, part in zip(pose.planes, step[PER_POSE:].reshape(-1, PER_PLANE), strict=True)
    )
    return replace(
        pose, frame=turned, vertex=pose.vertex + step[3:PER_POSE] * np.linalg.norm(pose.vertex), planes=planes
    )


def _mixing(off_square: Floats) -> Floats:
    """Symmetric (3, 3) matrix whose rows, in the corner's frame, are the faces' normals: I + ½ angles off diagonal."""
    mixing = np.eye(3)
    for angle, (i, j) in zip(off_square, _PAIRS, strict=True):
        mixing[i, j] = mixing[j, i] = angle / 2
    return mixing


def _normals_by_angles(state: State, capture: int) -> Floats:
    """Derivatives (P, 3 angles, 3) of the unit normals by the angles off square; zero for further planes."""
    pose = state.pose(capture)
    mixing = _mixing(state.off_square[pose.corner])
    lengths = np.linalg.norm(mixing, axis=1)
    unit = mixing / lengths[:, None]
    derivatives = np.zeros((len(FACES) + len(pose.planes), 3, 3))
    for angle, pair in enumerate(_PAIRS):
        for i, j in (pair, pair[::-1]):
            change = np.zeros(3)
            change[j] = 0.5
            derivatives[i, angle] = (change - unit[i] * (unit[i] @ change)) / lengths[i]
    turned: Floats = derivatives @ pose.frame
    return turned
