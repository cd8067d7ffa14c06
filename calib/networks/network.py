"""Devices and planes of one room: minimal parameters, and steps in their tangent space.

A room of stations is a set of pairs of camera and projector that share both devices' intrinsics and the motion between
them. A network is the general case: each device has intrinsics and a pose of its own, and a pair is any camera that
sees any projector's light. Cameras and projectors are the same to the mathematics: pinholes with lenses.

Columns of every step, gradient and Hessian: for each device its intrinsics (8), as in `calib.refinement`, the rotation
(3) about the room's axes and the translation (3) of its pose; then for each plane two tilts, along `tangent_basis` of
its normal, and its offset. The room's frame is the first device's, whose pose is held; lengths are in distances
between the first two devices.
"""

from dataclasses import dataclass

import numpy as np

from calib.geometry import Motion, cross
from calib.numerics import Floats
from calib.refinement import PER_DEVICE, moved_device
from calib.rooms.planes import PER_PLANE, RoomPlane
from calib.rooms.room import PER_PLACE, moved_place, moved_plane

PER_NODE = PER_DEVICE + PER_PLACE


@dataclass(frozen=True, eq=False)
class Device:
    """`lens` (8,): f, x_0, y_0, k1, k2, p1, p2, k3. `pose`: X_room = rotation X_device + translation."""

    lens: Floats
    pose: Motion

    def moved(self, step: Floats) -> "Device":
        """After a step (14,)."""
        return Device(moved_device(self.lens, step[:PER_DEVICE]), moved_place(self.pose, step[PER_DEVICE:]))


@dataclass(frozen=True, eq=False)
class Network:
    """All devices and planes."""

    devices: tuple[Device, ...]
    planes: tuple[RoomPlane, ...]

    @property
    def size(self) -> int:
        """Number of columns."""
        return PER_NODE * len(self.devices) + PER_PLANE * len(self.planes)

    def device_columns(self, device: int) -> slice:
        """Columns of a device, 14 of them."""
        return slice(PER_NODE * device, PER_NODE * (device + 1))

    def plane_columns(self, plane: int) -> slice:
        """Columns of a plane, 3 of them."""
        start = PER_NODE * len(self.devices) + PER_PLANE * plane
        return slice(start, start + PER_PLANE)

    def moved(self, step: Floats) -> "Network":
        """The network after a step (size,) in the columns' coordinates."""
        return Network(
            tuple(device.moved(step[self.device_columns(i)]) for i, device in enumerate(self.devices)),
            tuple(moved_plane(plane, step[self.plane_columns(i)]) for i, plane in enumerate(self.planes)),
        )


def turned_by(points: Floats) -> Floats:
    """How points (N, 3) follow a turn about the axes: ω × X for each axis ω, (N, 3, 3), components by rows."""
    turned: Floats = np.swapaxes(cross(np.eye(3)[None], points[:, None]), 1, 2)
    return turned
