"""Minimal parameters of a rig and the corners it sees, the prediction of each match, and the exact derivatives.

A camera pixel is unprojected, its ray is intersected with its plane, and the point is projected into the projector.
Lengths are in baselines: |translation| = 1.

Columns of every step, gradient and Hessian: camera log f, x_0, y_0, k1, k2, p1, p2, k3; the same for the projector;
rotation (3); direction of the translation (2); three angles off square for each corner; then, for each capture's
corner, its rotation (3), its vertex (3, as a share of its distance), and for each further plane two tilts and its
height; then, for each further photo, its rotation (3), the direction of its translation (2) and the logarithm of the
translation's length.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib.geometry import (
    FACES,
    PER_PLANE,
    PER_POSE,
    Intrinsics,
    Pose,
    depths_on_planes,
    polar,
    rotation_about,
    rotation_vector,
)
from calib.geometry import radial_distortion as lens
from calib.numerics import Floats, Ints
from calib.refinement.reprojection_jacobians import face_normals, reproject

PER_DEVICE = lens.PER_DEVICE
CAMERA, PROJECTOR = slice(0, PER_DEVICE), slice(PER_DEVICE, 2 * PER_DEVICE)
ROTATION, TRANSLATION = slice(16, 19), slice(19, 21)
SHARED = 21
TANGENTIAL = 5, 6  # of a device
TANGENTIAL_TERMS = tuple(device.start + term for device in (CAMERA, PROJECTOR) for term in TANGENTIAL)
WEAK_TERMS = tuple(device.start + term for device in (CAMERA, PROJECTOR) for term in range(5, PER_DEVICE))
PER_CORNER, PER_FURTHER = 3, 6

# Relative to the distance to the vertex, and in radians: views closer than this have the same optical errors.
_SAME_PLACE = 0.01

_POSE = np.arange(ROTATION.start, TRANSLATION.stop, dtype=np.int32)


@dataclass(frozen=True)
class FurtherPlane:
    """A plane that is roughly parallel or perpendicular to a face.

    `axes` (3, 3): unit rows in the coordinates of the corner's frame, the plane's normal and two directions to tilt
    it towards; `tilt` (2,) small; `height`: how far the corner's vertex is behind the plane, in baselines.
    """

    axes: Floats
    tilt: Floats
    height: float
    tilt_sigma: tuple[float, float]


@dataclass(frozen=True)
class PlacedCorner:
    """A corner in the frame of a capture's camera, without its angles off square."""

    frame: Floats
    """(3, 3): orthonormal rows along the legs; left-handed if the faces are numbered that way."""
    vertex: Floats
    """(3,)."""
    shape: int = 0
    """Index of its angles in the state's `off_square`; captures of one corner share it."""
    planes: tuple[FurtherPlane, ...] = ()
    """Further planes besides the three faces."""

    @property
    def size(self) -> int:
        """Number of columns."""
        return PER_POSE + PER_PLANE * len(self.planes)


@dataclass(frozen=True)
class State:
    """Both devices, their relative pose, and the corners that they see, with the minimal parameters' columns."""

    camera: Floats
    """(8,): f, x_0, y_0, k1, k2, p1, p2, k3."""
    projector: Floats
    """(8,): the same."""
    pose: Pose
    """X_projector = R X_camera + t, with |t| = 1."""
    off_square: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    """(G, 3): for each corner the angles in radians by which the faces (B, C), (C, A), (A, B) are off square."""
    corners: tuple[PlacedCorner, ...] = ()
    """For each capture, the corner that it shows."""
    one_camera: bool = False
    """The second device is the first at another place. The camera's columns then move both devices, and the projector's
    columns have no effect. There is one corner, as of the first photo. Capture 0 pairs the first photo with the second,
    each later capture with one of the `further` photos.
    """
    further: tuple[Pose, ...] = ()
    """Poses from the first photo to further ones."""

    @property
    def size(self) -> int:
        """Number of columns."""
        return self._starts[-1] + PER_FURTHER * len(self.further)

    @cached_property
    def _starts(self) -> tuple[int, ...]:
        """First column of each capture's corner, and the column after the last one."""
        starts = [SHARED + PER_CORNER * len(self.off_square)]
        for corner in self.corners:
            starts.append(starts[-1] + corner.size)
        return tuple(starts)

    def angle_columns(self, corner: int) -> slice:
        """Columns of a corner's angles."""
        return slice(SHARED + PER_CORNER * corner, SHARED + PER_CORNER * (corner + 1))

    @property
    def rig(self) -> "State":
        """Devices and pose alone."""
        return State(self.camera, self.projector, self.pose)

    def corner(self, capture: int) -> PlacedCorner:
        """The corner in a capture."""
        return self.corners[0 if self.one_camera else capture]

    def corner_columns(self, capture: int) -> slice:
        """Columns of a capture's corner and further planes."""
        number = 0 if self.one_camera else capture
        return slice(self._starts[number], self._starts[number + 1])

    def pose_of(self, capture: int) -> Pose:
        """From the camera to the second device of a capture."""
        return self.further[capture - 1] if self.one_camera and capture else self.pose

    def pose_columns(self, capture: int) -> Ints:
        """Columns of `pose_of`: rotation (3), direction (2), and of further photos the logarithm of the distance."""
        if not (self.one_camera and capture):
            return _POSE
        start = self._starts[-1] + PER_FURTHER * (capture - 1)
        return np.arange(start, start + PER_FURTHER, dtype=np.int32)

    def columns(self, capture: int) -> Ints:
        """The columns that a capture depends on, in the order of `predict`'s Jacobian."""
        every, pose = np.arange(self.size, dtype=np.int32), self.pose_columns(capture)
        angles, corner = self.angle_columns(self.corner(capture).shape), self.corner_columns(capture)
        return np.concatenate([every[: ROTATION.start], pose[:5], every[angles], every[corner], pose[5:]])

    def count(self, capture: int) -> int:
        """Number of columns that a capture depends on."""
        return SHARED + PER_CORNER + self.corner(capture).size + bool(self.one_camera and capture)

    def moved(self, step: Floats) -> "State":
        """The state after a step (size,) in the columns' coordinates."""
        camera = moved_device(self.camera, step[CAMERA])
        return replace(
            self,
            camera=camera,
            projector=camera if self.one_camera else moved_device(self.projector, step[PROJECTOR]),
            pose=self.pose.retract_baseline(step[_POSE]),
            off_square=self.off_square + step[SHARED : self._starts[0]].reshape(-1, PER_CORNER),
            corners=tuple(_moved_corner(corner, step[self.corner_columns(i)]) for i, corner in enumerate(self.corners)),
            further=tuple(
                pose.retract_baseline(step[self.pose_columns(i)]) for i, pose in enumerate(self.further, start=1)
            ),
        )

    def step_to(self, target: "State") -> Floats:
        """The step (size,) from here to a state of the same layout not too far away."""
        step = target.additive() - self.additive()
        for i in range(1 + len(self.further)):
            columns = self.pose_columns(i)
            step[columns] = self.pose_of(i).local_baseline(target.pose_of(i))[: len(columns)]
        for i, (here, there) in enumerate(zip(self.corners, target.corners, strict=True)):
            part = step[self.corner_columns(i)]
            part[:3] = rotation_vector(there.frame.T @ here.frame)
            part[3:PER_POSE] = (there.vertex - here.vertex) / np.linalg.norm(here.vertex)
            heights = [(a.height, b.height) for a, b in zip(here.planes, there.planes, strict=True)]
            part[PER_POSE + 2 :: PER_PLANE] = [b - a for a, b in heights]
        return step

    def additive(self) -> Floats:
        """Values (size,) of the additive columns, which may have a prior; zero for rotations and directions."""
        values = np.zeros(self.size)
        for columns, device in ((CAMERA, self.camera), (PROJECTOR, self.projector)):
            values[columns] = device
            values[columns.start] = np.log(device[0])
        values[SHARED : self._starts[0]] = self.off_square.ravel()
        for i, corner in enumerate(self.corners):
            for j, plane in enumerate(corner.planes):
                start = self._starts[i] + PER_POSE + PER_PLANE * j
                values[start : start + 2] = plane.tilt
        return values

    @property
    def followed(self) -> Ints:
        """For each column (size,) the column it is tied to: itself, unless both devices are one camera."""
        followed = np.arange(self.size, dtype=np.int32)
        if self.one_camera:
            followed[PROJECTOR] = followed[CAMERA]
        return followed

    def normals(self, capture: int = 0) -> Floats:
        """Unit normals of the faces in the camera's frame, (3, 3) rows."""
        corner = self.corner(capture)
        return face_normals(self.off_square[corner.shape], corner.frame)[0]

    def same_place(self, first: int, second: int) -> bool:
        """Return whether two captures see their corner from the same place: the rig was not moved in between."""
        here, there = self.corner(first).vertex, self.corner(second).vertex
        if np.linalg.norm(here - there) > _SAME_PLACE * np.linalg.norm(here):
            return False
        facing = np.abs(self.normals(first) @ self.normals(second).T).max(axis=1)
        return bool(facing.min() > np.cos(_SAME_PLACE))

    def legs(self, capture: int = 0) -> Floats:
        """Unit directions of the edges in the camera's frame, (3, 3) rows."""
        return polar(self.normals(capture))

    def points(self, camera_px: Floats, plane: Ints, capture: int = 0) -> Floats:
        """Intersect the rays of camera pixels (N, 2) with their faces (N,): points (N, 3) in the camera's frame."""
        rays, _ = lens.unproject(self.camera, camera_px)
        return depths_on_planes(rays, self.normals(capture)[plane], self.corner(capture).vertex)[:, None] * rays


def device_of(intrinsics: Intrinsics) -> Floats:
    """Return the parameters (8,) of a device; its pixels are taken as square, with the focal length along x."""
    return np.array([intrinsics.focal_px[0], *intrinsics.principal_point_px, *intrinsics.distortion])


def without_lens(focal_px: float, centre_px: Floats, k1: float = 0.0) -> Floats:
    """Return the parameters (8,) of a device with at most one radial term."""
    return np.array([focal_px, *centre_px, k1, 0.0, 0.0, 0.0, 0.0])


def intrinsic_distance(a: State, b: State) -> Floats:
    """Return absolute differences (4,) of both log focals and of the projector's principal point over its focal."""
    focals = np.log([a.camera[0] / b.camera[0], a.projector[0] / b.projector[0]])
    centre = (a.projector[1:3] - b.projector[1:3]) / b.projector[0]
    distance: Floats = np.abs(np.concatenate([focals, centre]))
    return distance


def predict(state: State, camera_px: Floats, plane: Ints, capture: int = 0) -> tuple[Floats, Floats, Floats]:
    """Predict the projector pixels of camera pixels (N, 2) on planes (N,) of a capture, with derivatives.

    Planes 0, 1, 2 are the corner's faces, 3 and up its further planes. Returns projector pixels (N, 2), the
    Jacobian (N, 2, columns) by `state.columns(capture)`, and depths (N, 2) in both devices (not positive where the
    prediction is invalid).
    """
    pose = state.pose_of(capture)
    return reproject(
        (state.camera, state.projector),
        np.ascontiguousarray(camera_px, np.float64),
        np.ascontiguousarray(plane, np.int32),
        *_planes(state, capture),
        state.corner(capture).vertex,
        np.ascontiguousarray(pose.rotation),
        pose.translation,
        _by_translation(state, capture),
        ((CAMERA if state.one_camera else PROJECTOR).start, ROTATION.start, SHARED),
    )


def _by_translation(state: State, capture: int) -> Floats:
    """Return the derivatives of a capture's translation by its columns, (3, columns)."""
    by_columns, pose = np.zeros((3, state.count(capture))), state.pose_of(capture)
    by_columns[:, TRANSLATION] = pose.by_direction
    if state.one_camera and capture:
        by_columns[:, -1] = pose.translation  # by the logarithm of its distance
    return by_columns


def _planes(state: State, capture: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return unit normals (P, 3) and heights (P,) of a capture's faces and further planes, in the camera's frame.

    Also return the normals' derivatives by the corner's angles (P, 3 angles, 3) and by the tilts (P, 2, 3).
    """
    corner = state.corner(capture)
    count = len(FACES) + len(corner.planes)
    normals, heights = np.empty((count, 3)), np.zeros(count)
    by_angles, by_tilts = np.zeros((count, 3, 3)), np.zeros((count, 2, 3))
    normals[: len(FACES)], by_angles[: len(FACES)] = face_normals(state.off_square[corner.shape], corner.frame)
    for i, plane in enumerate(corner.planes, start=len(FACES)):
        tilted = plane.axes[0] + plane.tilt @ plane.axes[1:]
        length = np.linalg.norm(tilted)
        unit = tilted / length
        normals[i], heights[i] = unit @ corner.frame, plane.height
        by_tilts[i] = (plane.axes[1:] - np.outer(plane.axes[1:] @ unit, unit)) / length @ corner.frame
    return normals, heights, by_angles, by_tilts


def moved_device(device: Floats, step: Floats) -> Floats:
    """A device (8,), or (9,) with an aspect, after a step in the columns of a device."""
    moved: Floats = device + step
    ratios = slice(1 + len(device) - PER_DEVICE)
    moved[ratios] = device[ratios] * np.exp(step[ratios])
    return moved


def _moved_corner(corner: PlacedCorner, step: Floats) -> PlacedCorner:
    planes = tuple(
        replace(plane, tilt=plane.tilt + part[:2], height=plane.height + float(part[2]))
        for plane, part in zip(corner.planes, step[PER_POSE:].reshape(-1, PER_PLANE), strict=True)
    )
    distance = np.sqrt(corner.vertex @ corner.vertex)
    frame, vertex = corner.frame @ rotation_about(step[:3]).T, corner.vertex + step[3:PER_POSE] * distance
    return PlacedCorner(frame, vertex, corner.shape, planes)
