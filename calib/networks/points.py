"""Points where a camera's and a projector's rays of a network meet, and what errors of the devices move them by."""

from collections.abc import Sequence

import numpy as np

from calib.geometry import depths_of_rays
from calib.networks.network import PER_NODE, Device
from calib.numerics import Floats

_STEP = 1e-5  # of every column, for central differences


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
