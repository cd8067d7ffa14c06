"""A person who walks between the devices and the corner, and a box there that is pushed aside."""

import numpy as np

from calib.numerics import Floats
from hw.settings import PasserSettings, PushedSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.shapes import Block

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
