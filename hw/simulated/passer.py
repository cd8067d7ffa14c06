"""Somebody who goes past between the devices and the corner."""

import numpy as np

from calib.numerics import Floats
from hw.settings import PasserSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.shapes import Block

_HEIGHT_M = 1.8
_WAY = 0.6  # how far on the way from the camera to the corner


def passer_in(frame: int, settings: PasserSettings, camera: PlacedDevice) -> Block | None:
    """The box in a frame, going at an even pace from the left to the right of the camera's view; None if it is gone."""
    if settings.width_m == 0 or not settings.first_frame <= frame <= settings.last_frame:
        return None
    steps = settings.last_frame - settings.first_frame
    share = (frame - settings.first_frame + 0.5) / (steps + 1)
    ahead, right = _level(camera.rotation[2]), _level(camera.rotation[0])
    distance = _WAY * float(np.linalg.norm(camera.centre[:2]))
    optics = camera.optics
    reach = distance * optics.width / 2 / optics.focal_px
    place = camera.centre * [1, 1, 0] + distance * ahead + (2 * share - 1) * reach * right
    edges = np.stack([settings.width_m * right, settings.width_m * -ahead, [0.0, 0.0, _HEIGHT_M]])
    if np.linalg.det(edges) < 0:
        edges[1] = -edges[1]
    return Block(place - 0.5 * (edges[0] + edges[1]), edges)


def _level(direction: Floats) -> Floats:
    flat = direction * [1, 1, 0]
    level: Floats = flat / np.linalg.norm(flat)
    return level
