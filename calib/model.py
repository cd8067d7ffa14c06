"""The true parameters of a rig before a corner, what they predict of each match, and the exact derivatives.

A camera pixel is unprojected, its ray meets the plane of its face, and the point is projected into the projector.
Lengths are in baselines: |translation| = 1. Both lenses have two radial terms.

Columns of the Jacobian, and of every step: camera log f, x_0, y_0, k1, k2; the same for the projector; rotation (3);
direction of the translation (2); the corner's three angles off square; then, for each capture, the corner's rotation
(3) and its vertex (3, as a share of its distance).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.arrays import Floats, Ints

CAMERA, PROJECTOR = slice(0, 5), slice(5, 10)
ROTATION, TRANSLATION, SQUARENESS = slice(10, 13), slice(13, 15), slice(15, 18)
SHARED = 18
PER_CAPTURE = 6

# (face, face) of each angle: angle 0 is between the faces 1 and 2, and so on round.
_PAIRS = ((1, 2), (2, 0), (0, 1))
_UNDISTORT_STEPS = 12


@dataclass(frozen=True)
class Pose:
    """Where the corner is in one capture: `frame` (3, 3), unit rows along the legs; `vertex` (3,); camera's frame."""

    frame: Floats
    vertex: Floats


@dataclass(frozen=True)
class State:
    """`camera`, `projector`: (5,) f, x_0, y_0, k1, k2. `rotation` (3, 3), `translation` (3,) of unit length.

    `off_square` (3,): angles in radians by which the faces (B, C), (C, A), (A, B) are off square.
    """

    camera: Floats
    projector: Floats
    rotation: Floats
    translation: Floats
    off_square: Floats
    poses: tuple[Pose, ...]

    @property
    def size(self) -> int:
        """Number of columns."""
        return SHARED + PER_CAPTURE * len(self.poses)

    def moved(self, step: Floats) -> "State":
        """The state after a step (size,) in the columns' coordinates."""
        poses = []
        for i, pose in enumerate(self.poses):
            part = step[SHARED + PER_CAPTURE * i :][:PER_CAPTURE]
            turned = pose.frame @ Rotation.from_rotvec(part[:3]).as_matrix().T
            poses.append(Pose(turned, pose.vertex + part[3:] * np.linalg.norm(pose.vertex)))
        translation = self.translation + tangent_basis(self.translation) @ step[TRANSLATION]
        return replace(
            self,
            camera=_moved_device(self.camera, step[CAMERA]),
            projector=_moved_device(self.projector, step[PROJECTOR]),
            rotation=Rotation.from_rotvec(step[ROTATION]).as_matrix() @ self.rotation,
            translation=translation / np.linalg.norm(translation),
            off_square=self.off_square + step[SQUARENESS],
            poses=tuple(poses),
        )

    def additive(self) -> Floats:
        """The columns that have a prior, as numbers that a step adds to, (size,): zero for rotations and the like."""
        values = np.zeros(self.size)
        for columns, device in ((CAMERA, self.camera), (PROJECTOR, self.projector)):
            values[columns] = np.concatenate([[np.log(device[0])], device[1:]])
        values[SQUARENESS] = self.off_square
        return values

    def normals(self, capture: int = 0) -> Floats:
        """Unit normals of the faces in the camera's frame, (3, 3) rows."""
        mixing = _mixing(self.off_square)
        unit: Floats = mixing / np.linalg.norm(mixing, axis=1, keepdims=True) @ self.poses[capture].frame
        return unit

    def legs(self, capture: int = 0) -> Floats:
        """Unit directions of the edges in the camera's frame, (3, 3) rows."""
        normals = self.normals(capture)
        legs = np.cross(np.roll(normals, -1, axis=0), np.roll(normals, -2, axis=0))
        legs *= np.sign(np.sum(legs * normals, axis=1))[:, None]
        unit: Floats = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        return unit


def tangent_basis(direction: Floats) -> Floats:
    """Two unit vectors (3, 2) perpendicular to a unit vector (3,)."""
    basis: Floats = np.linalg.svd(direction[None])[2][1:].T
    return basis


def predict(state: State, camera_px: Floats, face: Ints, capture: int = 0) -> tuple[Floats, Floats, Floats]:
    """Where matches at camera pixels (N, 2) on faces (N,) fall in the projector, with derivatives.

    Returns projector pixels (N, 2), the Jacobian (N, 2, size), and depths (N, 2) in both devices (not positive where
    the prediction means nothing).
    """
    rays, rays_by_camera = _unproject(state.camera, camera_px)
    normals, normals_by_angles = state.normals(capture)[face], _normals_by_angles(state, capture)[face]
    vertex = state.poses[capture].vertex
    facing = np.sum(normals * rays, axis=1)
    depth = np.sum(normals * vertex, axis=1) / facing
    points = depth[:, None] * rays

    # d(point) = depth (dr − r n·dr / n·r) + r / (n·r) (dn·(vertex − point) + n·dvertex)
    to_vertex = vertex - points
    along = rays / facing[:, None]
    by_camera = depth[:, None, None] * (
        rays_by_camera - along[:, :, None] * np.einsum("ni,nij->nj", normals, rays_by_camera)[:, None, :]
    )
    by_angles = along[:, :, None] * np.einsum("nai,ni->na", normals_by_angles, to_vertex)[:, None, :]
    by_frame = along[:, :, None] * np.cross(normals, to_vertex)[:, None, :]
    by_vertex = along[:, :, None] * (normals * np.linalg.norm(vertex))[:, None, :]

    turned = points @ state.rotation.T
    moved = turned + state.translation
    pixels, by_moved, by_projector = _project(state.projector, moved)

    by_point = by_moved @ state.rotation
    jacobian = np.zeros((len(face), 2, state.size))
    jacobian[:, :, CAMERA] = by_point @ by_camera
    jacobian[:, :, PROJECTOR] = by_projector
    # d(R X) = ω × R X, so each row g of by_moved gives g · (ω × RX) = ω · (RX × g).
    jacobian[:, :, ROTATION] = np.cross(turned[:, None, :], by_moved)
    jacobian[:, :, TRANSLATION] = by_moved @ tangent_basis(state.translation)
    jacobian[:, :, SQUARENESS] = by_point @ by_angles
    start = SHARED + PER_CAPTURE * capture
    jacobian[:, :, start : start + 3] = by_point @ by_frame
    jacobian[:, :, start + 3 : start + 6] = by_point @ by_vertex
    return pixels, jacobian, np.stack([depth, moved[:, 2]], axis=1)


def _moved_device(device: Floats, step: Floats) -> Floats:
    return np.concatenate([[device[0] * np.exp(step[0])], device[1:] + step[1:]])


def _mixing(off_square: Floats) -> Floats:
    """Symmetric (3, 3) matrix whose rows, in the corner's frame, are the faces' normals: I + ½ angles off diagonal."""
    mixing = np.eye(3)
    for angle, (i, j) in zip(off_square, _PAIRS, strict=True):
        mixing[i, j] = mixing[j, i] = angle / 2
    return mixing


def _normals_by_angles(state: State, capture: int) -> Floats:
    """Derivatives (3 faces, 3 angles, 3) of the unit normals by the angles off square."""
    mixing = _mixing(state.off_square)
    lengths = np.linalg.norm(mixing, axis=1)
    unit = mixing / lengths[:, None]
    derivatives = np.zeros((3, 3, 3))
    for angle, pair in enumerate(_PAIRS):
        for i, j in (pair, pair[::-1]):
            change = np.zeros(3)
            change[j] = 0.5
            derivatives[i, angle] = (change - unit[i] * (unit[i] @ change)) / lengths[i]
    turned: Floats = derivatives @ state.poses[capture].frame
    return turned


def _unproject(device: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    """Rays (N, 3) at z = 1 and their derivatives (N, 3, 5) by log f, x_0, y_0, k1, k2."""
    focal, centre, k = device[0], device[1:3], device[3:]
    distorted = (pixels - centre) / focal
    ideal = distorted * _inverse_radius_ratio(np.linalg.norm(distorted, axis=1), k)[:, None]
    _, slope, by_k = _radial(ideal, k)
    change = np.zeros((len(pixels), 2, 5))
    change[:, :, 0] = -distorted
    change[:, 0, 1] = change[:, 1, 2] = -1 / focal
    change[:, :, 3:] = -by_k
    derivatives = np.zeros((len(pixels), 3, 5))
    derivatives[:, :2] = _inverse_2x2(slope) @ change
    return np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1), derivatives


def _project(device: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Pixels (N, 2), their derivatives (N, 2, 3) by the point and (N, 2, 5) by log f, x_0, y_0, k1, k2."""
    focal, centre, k = device[0], device[1:3], device[3:]
    ideal = points[:, :2] / points[:, 2:]
    distorted, slope, by_k = _radial(ideal, k)
    by_point = np.zeros((len(points), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1.0
    by_point[:, :, 2] = -ideal
    by_point /= points[:, 2, None, None]
    by_device = np.zeros((len(points), 2, 5))
    by_device[:, :, 0] = focal * distorted
    by_device[:, 0, 1] = by_device[:, 1, 2] = 1.0
    by_device[:, :, 3:] = focal * by_k
    return focal * distorted + centre, focal * slope @ by_point, by_device


def _inverse_radius_ratio(distorted: Floats, k: Floats) -> Floats:
    """r / r_d (N,) for distorted radii (N,), by Newton's method on r (1 + k1 r² + k2 r⁴) = r_d."""
    ideal = distorted.copy()
    for _ in range(_UNDISTORT_STEPS):
        r2 = ideal**2
        step = (ideal * (1 + r2 * (k[0] + r2 * k[1])) - distorted) / (1 + r2 * (3 * k[0] + 5 * r2 * k[1]))
        ideal = ideal - step
        if np.abs(step).max(initial=0.0) < 1e-13:
            break
    return np.where(distorted > 0, ideal / np.where(distorted > 0, distorted, 1.0), 1.0)


def _inverse_2x2(matrices: Floats) -> Floats:
    """Inverses of (N, 2, 2)."""
    a, b, c, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1]
    adjugate = np.stack([d, -b, -c, a], axis=1).reshape(-1, 2, 2)
    inverse: Floats = adjugate / (a * d - b * c)[:, None, None]
    return inverse


def _radial(ideal: Floats, k: Floats) -> tuple[Floats, Floats, Floats]:
    """x (1 + k1 r² + k2 r⁴) of (N, 2), its Jacobian (N, 2, 2) by x and (N, 2, 2) by k1, k2."""
    r2 = np.sum(ideal**2, axis=1)
    factor = 1 + r2 * (k[0] + r2 * k[1])
    slope = 2 * (k[0] + 2 * k[1] * r2)
    jacobian = slope[:, None, None] * ideal[:, :, None] * ideal[:, None, :]
    jacobian[:, 0, 0] += factor
    jacobian[:, 1, 1] += factor
    return ideal * factor[:, None], jacobian, ideal[:, :, None] * np.stack([r2, r2**2], axis=1)[:, None, :]
