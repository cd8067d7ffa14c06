"""A device that is not placed yet, from known points that it sees: the direct linear transform."""

import numpy as np

from calib.closed_form import decompose
from calib.geometry import Motion, homogeneous, nearest_depths, normalisation, unproject
from calib.networks.network import Device
from calib.numerics import Floats

# Of the largest eigenvalue, and over the smallest one: less, and points on one plane leave the device open.
_TOLD, _OVER_NOISE = 1e-9, 30.0


def triangulated(camera: Device, projector: Device, camera_px: Floats, projector_px: Floats) -> Floats:
    """Points (N, 3) of a network on the camera's rays, where these are nearest to the projector's."""
    rays, back = (
        unproject(device.lens, pixels)[0] @ device.pose.rotation.T
        for device, pixels in ((camera, camera_px), (projector, projector_px))
    )
    depth = nearest_depths(rays, back, camera.pose.translation - projector.pose.translation)[0]
    points: Floats = camera.pose.translation + depth[:, None] * rays
    return points


def placed(points: Floats, pixels: Floats) -> Device | None:
    """A device, without lens terms, that sees points (N, 3) at pixels (N, 2); None of points on one plane.

    Hartley & Zisserman, section 7.1.
    """
    scale, centre = normalisation(pixels), points.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1))))
    ideal = homogeneous(pixels) @ scale.T
    solid = homogeneous((points - centre) / spread)
    rows = np.zeros((2 * len(points), 12))
    rows[0::2, 0:4], rows[0::2, 8:12] = solid, -ideal[:, :1] * solid
    rows[1::2, 4:8], rows[1::2, 8:12] = solid, -ideal[:, 1:2] * solid
    values, vectors = np.linalg.eigh(rows.T @ rows)
    if values[1] < max(_TOLD * values[-1], _OVER_NOISE * values[0]):
        return None
    motion = np.linalg.inv(scale) @ vectors[:, 0].reshape(3, 4)
    matrix, rotation, translation = (each[0] for each in decompose(motion[None]))
    if not (np.isfinite(matrix).all() and np.isfinite(rotation).all()):
        return None
    lens = np.array([np.sqrt(matrix[0, 0] * matrix[1, 1]), *matrix[:2, 2], 0.0, 0.0, 0.0, 0.0, 0.0])
    back = rotation.T
    device = Device(lens, Motion(back, centre - spread * (back @ translation)))
    ahead = (points - device.pose.translation) @ back[:, 2]
    return device if np.median(ahead) > 0 else None
