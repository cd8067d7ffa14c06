"""What moves during a capture: devices, bumped once or drifting, a person who walks in front of the corner, and a box
there that is pushed aside.
"""

from dataclasses import replace

import numpy as np

from calib.numerics import Floats
from hw.settings import BumpSettings, DriftSettings, PasserSettings, PushedSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.shapes import Block

# Centre of rotation in the device's frame, in metres: the head of the tripod, below and behind the lens.
_HEAD_M = np.array([0.0, 0.15, -0.05])


def offset_px(device: str, bump: BumpSettings, drift: DriftSettings, frame: int) -> Floats:
    """Displacement of the picture of a device ('camera', 'projector') in a frame, (2,) in its own pixels."""
    offset = np.zeros(2)
    if bump.device == device and frame >= bump.frame:
        offset += bump.px * _direction(bump.direction_deg)
    if drift.device == device:
        offset += frame * drift.px_per_frame * _direction(drift.direction_deg)
    return offset


def turned(device: PlacedDevice, px: Floats) -> PlacedDevice:
    """A device on its tripod, rotated so that the point on its axis moves by `px` (2,) pixels in its picture."""
    x, y = px / device.optics.focal_px
    axis = np.array([-y, x, 0.0])
    rotation = _rotation(axis) @ device.rotation
    head = device.centre + device.rotation.T @ _HEAD_M
    return replace(device, rotation=rotation, centre=head - rotation.T @ _HEAD_M)


def rotation_homography(before: PlacedDevice, after: PlacedDevice) -> Floats:
    """Homography (3, 3) from pixels after a rotation to pixels with the same direction before it, without lens
    distortion.
    """
    return _matrix(before) @ before.rotation @ after.rotation.T @ np.linalg.inv(_matrix(after))


def _direction(angle_deg: float) -> Floats:
    return np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])


def _rotation(vector: Floats) -> Floats:
    """Rotation (3, 3) about an axis (3,) perpendicular to the optical axis. The length of the axis is tan(angle)."""
    tangent = float(np.linalg.norm(vector))
    if tangent == 0:
        return np.eye(3)
    x, y, z = vector / tangent
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.arctan(tangent)
    rotation: Floats = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return rotation


def _matrix(device: PlacedDevice) -> Floats:
    optics = device.optics
    x0, y0 = optics.principal_point_px
    return np.array([[optics.focal_px, 0.0, x0], [0.0, optics.focal_px, y0], [0.0, 0.0, 1.0]])


_HEIGHT_M = 1.8
_BOX_HEIGHT_M = 1.2
_RELATIVE_DISTANCE = 0.6  # distance from the camera over its distance from the corner


def person_in(frame: int, settings: PasserSettings, camera: PlacedDevice) -> Block | None:
    """The person in a frame, as a box that crosses the camera's view from left to right; None if absent."""
    if settings.width_m == 0 or not settings.first_frame <= frame <= settings.last_frame:
        return None
    steps = settings.last_frame - settings.first_frame
    share = (frame - settings.first_frame + 0.5) / (steps + 1)
    optics = camera.optics
    reach = _distance(camera) * optics.width / 2 / optics.focal_px
    return _upright(settings.width_m, _HEIGHT_M, (2 * share - 1) * reach, camera)


def box_in(frame: int, settings: PushedSettings, camera: PlacedDevice) -> Block | None:
    """The box in a frame, in the middle of the camera's view until it is pushed; None if there is none."""
    if settings.width_m == 0:
        return None
    return _upright(settings.width_m, _BOX_HEIGHT_M, settings.by_m if frame >= settings.frame else 0.0, camera)


def _distance(camera: PlacedDevice) -> float:
    return _RELATIVE_DISTANCE * float(np.linalg.norm(camera.centre[:2]))


def _upright(width_m: float, height_m: float, aside_m: float, camera: PlacedDevice) -> Block:
    """A box on the floor, `aside_m` to the right of the middle of the camera's view."""
    ahead, right = _level(camera.rotation[2]), _level(camera.rotation[0])
    place = camera.centre * [1, 1, 0] + _distance(camera) * ahead + aside_m * right
    edges = np.stack([width_m * right, width_m * -ahead, [0.0, 0.0, height_m]])
    if np.linalg.det(edges) < 0:
        edges[1] = -edges[1]
    return Block(place - 0.5 * (edges[0] + edges[1]), edges)


def _level(direction: Floats) -> Floats:
    flat = direction * [1, 1, 0]
    return flat / np.linalg.norm(flat)
