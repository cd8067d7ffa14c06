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

from calib.geometry import PER_PLANE, PER_POSE, Plane, Pose, Size, depths_of_rays, project_into, unproject_into
from calib.numerics import Floats, compiled
from calib.refinement import PER_DEVICE, moved_device

PER_WARP = 4
PER_NODE = PER_DEVICE + PER_POSE + PER_WARP
POSE, PLACE = slice(PER_DEVICE, PER_DEVICE + PER_POSE), slice(PER_DEVICE + 3, PER_DEVICE + PER_POSE)
WARP = slice(PER_DEVICE + PER_POSE, PER_NODE)  # all of a device's own columns
_STEP = 1e-5  # of every column, for central differences

# Lens (8,), warp (4,), width and height (2,), rotation (3, 3) and translation (3,) of its pose.
DeviceNumbers = tuple[Floats, Floats, Floats, Floats, Floats]


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
        count = len(pixels)
        rays, by_lens, by_warp = np.empty((count, 3)), np.zeros((count, 3, PER_DEVICE)), np.zeros((count, 3, PER_WARP))
        rays_into(self.lens, self.warp, self._sides, np.ascontiguousarray(pixels, np.float64), rays, by_lens, by_warp)
        return rays, by_lens, by_warp

    def pixels(self, points: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Of points (N, 3) in its frame, (N, 2); derivatives by the point (N, 2, 3), lens and warp, as above."""
        count = len(points)
        pixels, by_point = np.empty((count, 2)), np.empty((count, 2, 3))
        by_lens, by_warp = np.zeros((count, 2, PER_DEVICE)), np.zeros((count, 2, PER_WARP))
        before = np.ascontiguousarray(points, np.float64)
        pixels_into(self.lens, self.warp, self._sides, before, pixels, by_point, by_lens, by_warp)
        return pixels, by_point, by_lens, by_warp

    @property
    def numbers(self) -> DeviceNumbers:
        """What compiled functions take."""
        return self.lens, self.warp, self._sides, np.ascontiguousarray(self.pose.rotation), self.pose.translation

    @property
    def _sides(self) -> Floats:
        return np.array(self.size, np.float64)


@compiled
def rays_into(
    lens: Floats, warp: Floats, sides: Floats, pixels: Floats, rays: Floats, by_lens: Floats, by_warp: Floats
) -> None:
    """`Device.rays`, into empty `rays` and zeros."""
    width, height = sides
    lean_x, lean_y = warp[2] / width, warp[3] / height
    square, back, unwarped = np.empty((len(pixels), 2)), np.empty((len(pixels), 2, 2)), np.empty((len(pixels), 2))
    for i in range(len(pixels)):
        x, y = pixels[i, 0] - (width - 1) / 2, pixels[i, 1] - (height - 1) / 2
        # d from A d / (1 + lean · d) = (x, y): (A − (x, y) leanᵀ) d = (x, y).
        a, b, c, d = 1 + warp[0] - x * lean_x, warp[1] - x * lean_y, -y * lean_x, 1 - y * lean_y
        determinant = a * d - b * c
        back[i, 0, 0], back[i, 0, 1] = d / determinant, -b / determinant
        back[i, 1, 0], back[i, 1, 1] = -c / determinant, a / determinant
        square[i, 0], square[i, 1] = back[i, 0, 0] * x + back[i, 0, 1] * y, back[i, 1, 0] * x + back[i, 1, 1] * y
        unwarped[i, 0], unwarped[i, 1] = square[i, 0] + (width - 1) / 2, square[i, 1] + (height - 1) / 2
    unproject_into(lens, unwarped, rays, by_lens)
    for i in range(len(pixels)):
        x, y = square[i]
        for k in range(2):
            by_x, by_y = by_lens[i, k, 1], by_lens[i, k, 2]  # by the centre, opposite to those by the pixel
            affine, lean = by_x * back[i, 0, 0] + by_y * back[i, 1, 0], by_x * x + by_y * y
            by_warp[i, k, 0], by_warp[i, k, 1] = affine * x, affine * y
            by_warp[i, k, 2], by_warp[i, k, 3] = -lean * x / width, -lean * y / height


@compiled
def pixels_into(
    lens: Floats,
    warp: Floats,
    sides: Floats,
    points: Floats,
    pixels: Floats,
    by_point: Floats,
    by_lens: Floats,
    by_warp: Floats,
) -> None:
    """`Device.pixels`, into empty `pixels` and `by_point`, and zeros."""
    project_into(lens, points, pixels, by_point, by_lens)
    width, height = sides
    lean_x, lean_y = warp[2] / width, warp[3] / height
    is_warped = warp[0] != 0 or warp[1] != 0 or warp[2] != 0 or warp[3] != 0
    for i in range(len(points)):
        x, y = pixels[i, 0] - (width - 1) / 2, pixels[i, 1] - (height - 1) / 2
        lengthened = 1 + x * lean_x + y * lean_y
        off = (((1 + warp[0]) * x + warp[1] * y) / lengthened, y / lengthened)
        by_warp[i, 0, 0], by_warp[i, 0, 1] = x / lengthened, y / lengthened
        for k in range(2):
            by_warp[i, k, 2], by_warp[i, k, 3] = -off[k] * x / width / lengthened, -off[k] * y / height / lengthened
        pixels[i, 0], pixels[i, 1] = off[0] + (width - 1) / 2, off[1] + (height - 1) / 2
        if is_warped:
            a, b = (1 + warp[0] - off[0] * lean_x) / lengthened, (warp[1] - off[0] * lean_y) / lengthened
            c, d = -off[1] * lean_x / lengthened, (1 - off[1] * lean_y) / lengthened
            for by in (by_point[i], by_lens[i]):
                for column in range(by.shape[1]):
                    first, second = by[0, column], by[1, column]
                    by[0, column], by[1, column] = a * first + b * second, c * first + d * second


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
