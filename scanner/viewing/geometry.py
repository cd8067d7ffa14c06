"""Where things are drawn: frusta, rulers, and from where one looks at it all. Arrays only."""

from dataclasses import dataclass
from math import floor, log10

import numpy as np

from calib.arrays import Floats
from calib.camera import Intrinsics
from scanner.viewing.decimation import shuffled
from scanner.viewing.result import ViewedCloud

_SAMPLED = 20_000
_TICKS_WANTED = 4
# The view's middle: from the cloud's so far towards the devices.
_TOWARDS_RIG = 0.35


@dataclass(frozen=True)
class Viewpoint:
    """From `position` (3,) towards `target` (3,), with `up` (3,) at the top."""

    position: Floats
    target: Floats
    up: Floats


def typical_size(cloud: ViewedCloud) -> float:
    """How far most points are from the middle one, in the cloud's unit."""
    points = _some(cloud)
    return float(np.quantile(np.linalg.norm(points - np.median(points, axis=0), axis=1), 0.9)) or 1.0


def viewpoint(cloud: ViewedCloud) -> Viewpoint:
    """From behind, above and beside the newest camera into the corner; without a camera, towards the cloud's origin."""
    points = _some(cloud)
    middle, size = np.median(points, axis=0), typical_size(cloud)
    if not cloud.rigs:
        ahead = -middle if np.any(middle) else np.array([1.0, 1.0, -1.0])
        ahead = ahead / np.linalg.norm(ahead)
        return Viewpoint(middle - 3 * size * ahead, middle, cloud.up)
    devices = [centre for rig in cloud.rigs for centre in (rig.position, rig.projector_centre)]
    eye, between = cloud.rigs[0].position, np.mean(devices, axis=0)
    level = middle - eye
    level = level - (level @ cloud.up) * cloud.up
    level /= np.linalg.norm(level)
    aside = np.cross(level, cloud.up)
    # On the far side of the camera from the projector neither stands before the other.
    aside *= -1.0 if (between - eye) @ aside > 0 else 1.0
    target = middle + _TOWARDS_RIG * (between - middle)
    spread = max(float(np.linalg.norm(centre - target)) for centre in devices)
    away = 0.75 * max(size, spread)
    return Viewpoint(eye + away * (cloud.up - level + 0.6 * aside), target, cloud.up)


def _some(cloud: ViewedCloud) -> Floats:
    return cloud.points[shuffled(len(cloud.points))[:_SAMPLED]]


def picture_corners(device: Intrinsics, depth: float) -> Floats:
    """The corners of a device's image at `depth` before it, (4, 3) in its frame: clockwise from the top left.

    Lens distortion is left out: straight lines stay straight, as in the picture of a frustum.
    """
    right, bottom = device.width - 0.5, device.height - 0.5
    corners = np.array([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    rays = (corners - np.array(device.principal_point_px)) / np.array(device.focal_px)
    return depth * np.column_stack([rays, np.ones(4)])


def frustum_lines(corners: Floats) -> Floats:
    """The eight edges (8, 2, 3) of the pyramid from the origin to `corners` (4, 3)."""
    from_apex = np.stack([np.zeros_like(corners), corners], axis=1)
    return np.concatenate([from_apex, np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)])


def nice_step(length: float) -> float:
    """1, 2 or 5 times a power of ten, about four of which make `length` > 0."""
    wanted = length / _TICKS_WANTED
    decade = 10.0 ** floor(log10(wanted))
    return float(max(factor for factor in (1, 2, 5) if factor * decade <= wanted * (1 + 1e-9)) * decade)


def ruler_lines(start: Floats, direction: Floats, across: Floats, length: float) -> Floats:
    """A ruler (n, 2, 3) from `start` along the unit vector `direction`, a tick along `across` at each nice step."""
    step = nice_step(length)
    at = start + np.arange(0, floor(length / step + 1e-9) + 1)[:, None] * step * direction
    ticks = np.stack([at, at + 0.25 * step * across], axis=1)
    return np.concatenate([np.stack([at[0], at[-1]])[None], ticks])
