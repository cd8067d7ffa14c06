"""Devices that do not stand still during a capture: knocked against once, or turning slowly."""

from dataclasses import replace

import numpy as np

from calib.numerics import Floats
from hw.settings import BumpSettings, DriftSettings
from hw.simulated.device import PlacedDevice

# Where the head of the tripod is that a device turns about, in metres in the device's frame: below and behind the lens.
_HEAD_M = np.array([0.0, 0.15, -0.05])


def offset_px(device: str, bump: BumpSettings, drift: DriftSettings, frame: int) -> Floats:
    """How far the picture of a device ('camera', 'projector') has moved in a frame, (2,) in its own pixels."""
    offset = np.zeros(2)
    if bump.device == device and frame >= bump.frame:
        offset += bump.px * _direction(bump.direction_deg)
    if drift.device == device:
        offset += frame * drift.px_per_frame * _direction(drift.direction_deg)
    return offset


def turned(device: PlacedDevice, px: Floats) -> PlacedDevice:
    """A device on its tripod, turned so that what was on the axis moves by some pixels (2,) in its picture."""
    x, y = px / device.optics.focal_px
    axis = np.array([-y, x, 0.0])
    rotation = _rotation(axis) @ device.rotation
    head = device.centre + device.rotation.T @ _HEAD_M
    return replace(device, rotation=rotation, centre=head - rotation.T @ _HEAD_M)


def steered(before: PlacedDevice, after: PlacedDevice) -> Floats:
    """Takes pixels after a turn to those that looked the same way before it, (3, 3), without lens distortion."""
    matrix: Floats = _matrix(before) @ before.rotation @ after.rotation.T @ np.linalg.inv(_matrix(after))
    return matrix


def _direction(angle_deg: float) -> Floats:
    return np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])


def _rotation(vector: Floats) -> Floats:
    """About an axis (3,) at right angles to the optical one; its length is the tangent of the angle."""
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
