"""Devices that move during a capture: bumped once, or drifting."""

from dataclasses import replace

import numpy as np

from calib.numerics import Floats
from hw.settings import BumpSettings, DriftSettings
from hw.simulated.device import PlacedDevice

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
