"""Geometry of the view: frusta, rulers, viewpoint. Arrays only."""

from dataclasses import dataclass
from math import floor, log10

import numpy as np

from calib.geometry import Intrinsics
from calib.numerics import Floats
from scanner.viewing.decimation import shuffled
from scanner.viewing.result import ViewedCloud

_SAMPLED = 20_000
_TICKS_WANTED = 4
FIELD_OF_VIEW_RAD = float(np.radians(50.0))
# Aspect ratio of a window beside the panel, until the browser reports it.
USUAL_ASPECT = 1.0
_MARGIN = 1.1
_ABOVE, _BESIDE = 0.7, 0.5


@dataclass(frozen=True)
class Viewpoint:
    """A view from `position` (3,) towards `target` (3,), with `up` (3,) at the top."""

    position: Floats
    target: Floats
    up: Floats


def typical_size(cloud: ViewedCloud) -> float:
    """Return the distance of most points from the median point, in the cloud's unit."""
    points = _some(cloud)
    return float(np.quantile(np.linalg.norm(points - np.median(points, axis=0), axis=1), 0.9)) or 1.0


def viewpoint(cloud: ViewedCloud, aspect: float = USUAL_ASPECT) -> Viewpoint:
    """Return the view from behind, above and beside the newest camera into the corner, with cloud and devices in view.

    `aspect`: of the window, width over height.
    """
    points = _some(cloud)
    middle = np.median(points, axis=0)
    devices = np.array([centre for rig in cloud.rigs for centre in (rig.position, rig.projector_centre)]).reshape(-1, 3)
    eye = cloud.rigs[0].position if cloud.rigs else np.zeros(3)
    level = middle - eye
    level = level - (level @ cloud.up) * cloud.up
    level /= np.linalg.norm(level)
    aside = np.cross(level, cloud.up)
    # Seen from beyond the camera, neither device hides the other.
    aside *= -1.0 if len(devices) and (devices.mean(axis=0) - eye) @ aside > 0 else 1.0
    backward = _ABOVE * cloud.up - level + _BESIDE * aside
    backward /= np.linalg.norm(backward)
    right = np.cross(cloud.up, backward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(backward, right), backward])
    near = np.linalg.norm(points - middle, axis=1) <= 2 * typical_size(cloud)  # outliers may be out of sight
    in_view = np.concatenate([points[near], devices]) @ axes.T
    centre = (in_view.min(axis=0) + in_view.max(axis=0)) / 2
    in_view -= centre
    half = np.tan(FIELD_OF_VIEW_RAD / 2) / _MARGIN
    distance = float(np.max(in_view[:, 2] + np.max(np.abs(in_view[:, :2]) / (half * aspect, half), axis=1)))
    target = centre @ axes
    return Viewpoint(target + distance * backward, target, cloud.up)


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


def nice_step(length: float) -> float:
    """1, 2 or 5 times a power of ten, about a quarter of `length` > 0."""
    wanted = length / _TICKS_WANTED
    decade = 10.0 ** floor(log10(wanted))
    return float(max(factor for factor in (1, 2, 5) if factor * decade <= wanted * (1 + 1e-9)) * decade)


def ruler_lines(start: Floats, direction: Floats, across: Floats, length: float) -> Floats:
    """A ruler (n, 2, 3) from `start` along the unit vector `direction`, a tick along `across` at each nice step."""
    step = nice_step(length)
    at = start + np.arange(0, floor(length / step + 1e-9) + 1)[:, None] * step * direction
    ticks = np.stack([at, at + 0.25 * step * across], axis=1)
    return np.concatenate([np.stack([at[0], at[-1]])[None], ticks])
