"""Devices and planes of one room: minimal parameters, and steps in their tangent space.

A room of stations is a set of pairs of camera and projector that share both devices' intrinsics and the motion between
them. A network is the general case: each device has intrinsics and a pose of its own, and a pair is any camera that
sees any projector's light. Cameras and projectors are the same to the mathematics: pinholes with lenses.

Columns of every step, gradient and Hessian: for each device its intrinsics (8), as in `calib.refinement`, the rotation
(3) about the room's axes and the translation (3) of its pose, and the warp (4) of its picture; then for each plane two
tilts, along `tangent_basis` of its normal, and its offset. The room's frame is the first device's, whose pose is held;
lengths are in distances between the first two devices. Pictures have no warp, unless that is doubted.

Points where a camera's and a projector's rays of a network meet, and what errors of the devices move them by.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.geometry import PER_PLANE, PER_POSE, Plane, Pose, Size, depths_of_rays, project, unproject
from calib.numerics import Floats
from calib.refinement import PER_DEVICE, moved_device

PER_WARP = 4
PER_NODE = PER_DEVICE + PER_POSE + PER_WARP
POSE, PLACE = slice(PER_DEVICE, PER_DEVICE + PER_POSE), slice(PER_DEVICE + 3, PER_DEVICE + PER_POSE)
WARP = slice(PER_DEVICE + PER_POSE, PER_NODE)  # all of a device's own columns
_STEP = 1e-5  # of every column, for central differences


@dataclass(frozen=True, eq=False)
class Device:
    """`lens` (8,): f, x_0, y_0, k1, k2, p1, p2, k3. `pose`: X_room = rotation X_device + translation.

    `warp` (4,) of a picture that is shown, or was recorded, through a homography, as by keystone correction: aspect a,
    skew s, and by how much its right and lower edges are shorter than those opposite, l and m. Square pixels at d from
    the middle of a picture of this `size` are at A d / (1 + (l, m) · d / size), A = [1 + a, s; 0, 1]. All other
    homographies are similarities, which other values of f, x_0, y_0 and of the pose are as good as.
    """

    lens: Floats
    pose: Pose
    size: Size
    warp: Floats = field(default_factory=lambda: np.zeros(PER_WARP))

    def moved(self, step: Floats) -> "Device":
        """After a step (18,)."""
        lens = moved_device(self.lens, step[:PER_DEVICE])
        return Device(lens, self.pose.retract(step[POSE]), self.size, self.warp + step[WARP])

    def rays(self, pixels: Floats) -> tuple[Floats, Floats, Floats]:
        """Through pixels (N, 2), (N, 3) at z = 1; derivatives by the lens (N, 3, 8) and by the warp (N, 3, 4)."""
        square: Floats = pixels - self._middle
        back: Floats = np.broadcast_to(np.eye(2), (len(pixels), 2, 2))
        if self.warp.any():
            back = np.linalg.inv(self._affine - square[:, :, None] * self._lean).astype(np.float64)
            square = np.einsum("nij,nj->ni", back, square)
        rays, by_lens = unproject(self.lens, self._middle + square)
        by_lean = square[:, :, None] * square[:, None] / self.size
        by_warp = by_lens[:, :, 1:3] @ np.concatenate([back[:, :, :1] * square[:, None], -by_lean], axis=2)
        return rays, by_lens, by_warp

    def pixels(self, points: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Of points (N, 3) in its frame, (N, 2); derivatives by the point (N, 2, 3), lens and warp, as above."""
        pixels, by_point, by_lens = project(self.lens, points)
        square = pixels - self._middle
        lengthened = (1 + square @ self._lean)[:, None]
        off = square @ self._affine.T / lengthened
        by_warp = np.zeros((len(points), 2, PER_WARP))
        by_warp[:, 0, :2] = square / lengthened
        by_warp[:, :, 2:] = -off[:, :, None] * (square / self.size / lengthened)[:, None]
        if self.warp.any():
            by_square = (self._affine - off[:, :, None] * self._lean) / lengthened[:, :, None]
            by_point, by_lens = by_square @ by_point, by_square @ by_lens
        return self._middle + off, by_point, by_lens, by_warp

    @property
    def _middle(self) -> Floats:
        return (np.array(self.size) - 1) / 2

    @property
    def _affine(self) -> Floats:
        return np.array([[1 + self.warp[0], self.warp[1]], [0.0, 1.0]])

    @property
    def _lean(self) -> Floats:
        return self.warp[2:] / self.size


@dataclass(frozen=True, eq=False)
class Network:
    """All devices and planes."""

    devices: tuple[Device, ...]
    planes: tuple[Plane, ...]

    @property
    def size(self) -> int:
        """Number of columns."""
        return PER_NODE * len(self.devices) + PER_PLANE * len(self.planes)

    def device_columns(self, device: int) -> slice:
        """Columns of a device, 18 of them."""
        return slice(PER_NODE * device, PER_NODE * (device + 1))

    def plane_columns(self, plane: int) -> slice:
        """Columns of a plane, 3 of them."""
        start = PER_NODE * len(self.devices) + PER_PLANE * plane
        return slice(start, start + PER_PLANE)

    def moved(self, step: Floats) -> "Network":
        """The network after a step (size,) in the columns' coordinates."""
        return Network(
            tuple(device.moved(step[self.device_columns(i)]) for i, device in enumerate(self.devices)),
            tuple(plane.retract(step[self.plane_columns(i)]) for i, plane in enumerate(self.planes)),
        )


def meeting_points(camera: Device, projector: Device, camera_px: Floats, projector_px: Floats) -> Floats:
    """Midpoints (N, 3) of the rays' common perpendiculars, in the network's frame, of pixels (N, 2) of two devices."""
    u, v = (
        device.pose.rotate(device.rays(pixels)[0])
        for device, pixels in ((camera, camera_px), (projector, projector_px))
    )
    s, t = depths_of_rays(u, v, camera.pose.translation - projector.pose.translation).T
    first, second = camera.pose.translation + s[:, None] * u, projector.pose.translation + t[:, None] * v
    middle: Floats = (first + second) / 2
    return middle


def point_slopes(devices: Sequence[Device], pair: tuple[int, int], camera_px: Floats, projector_px: Floats) -> Floats:
    """Derivatives (3, 18 D) of the point of one match, of pixels (2,) of a camera and a projector, which `pair`
    numbers, by the columns of all devices (D).
    """
    slopes = np.zeros((3, PER_NODE * len(devices)))
    pixels = camera_px[None], projector_px[None]
    for role, device in enumerate(pair):
        for column in range(PER_NODE):
            step, ends = np.zeros(PER_NODE), []
            for sign in (1, -1):
                step[column] = sign * _STEP
                both = [devices[pair[0]], devices[pair[1]]]
                both[role] = both[role].moved(step)
                ends.append(meeting_points(both[0], both[1], *pixels)[0])
            slopes[:, PER_NODE * device + column] = (ends[0] - ends[1]) / (2 * _STEP)
    return slopes
