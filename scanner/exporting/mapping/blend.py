"""The share of light of each projector where several overlap: smooth weights that add up to one.

The weight of a projector is the square of the distance, in its image, from the edge of its region, over the sum of all
projectors' there. At its edge it vanishes smoothly. An edge is that of the image, the content, a hole, or an occlusion.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from calib.numerics import Bools, Floats
from scanner.exporting.mapping.projector_view import ProjectorView

_EDGE = 0.02  # relative depth step to a neighbour, beyond that of a plane
_SAME = 0.005  # relative depth difference within one surface


def blend_weights(projectors: Sequence[ProjectorView], shown: Sequence[Bools]) -> list[Floats]:
    """Weights (H, W) in linear light of each projector's pixels, 0 where `shown` (H, W) is false."""
    inward = [_from_edge(view, mask) for view, mask in zip(projectors, shown, strict=True)]
    weights = []
    for number, (view, own) in enumerate(zip(projectors, inward, strict=True)):
        total = own**2
        for other, (elsewhere, distance) in enumerate(zip(projectors, inward, strict=True)):
            if other != number:
                total = total + _at(elsewhere, distance, view.points) ** 2
        weights.append(np.where(shown[number], own**2 / np.where(total > 0, total, 1.0), 0.0))
    return weights


def _from_edge(view: ProjectorView, shown: Bools) -> Floats:
    """Distance (H, W) from the nearest edge, over the image's height."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / view.depth  # inverse depth of a plane is linear in the image
    steps = np.zeros(shown.shape)
    for axis in (0, 1):
        bent = np.abs(np.diff(inverse, 2, axis=axis, prepend=np.nan, append=np.nan)) * view.depth
        steps = np.fmax(steps, bent)
    inside = np.pad(shown & (steps < _EDGE), 1).astype(np.uint8)
    distance = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    # Pixels at the very edge need a projector, too.
    return np.where(shown, np.maximum(distance, 0.5), 0.0) / len(shown)


def _at(view: ProjectorView, distance: Floats, points: Floats) -> Floats:
    """Another projector's distance from its edge where it lights the same points (H, W, 3); 0 where it does not."""
    place = view.projector.place
    before = (points - place.translation) @ place.rotation
    pixels = np.nan_to_num(view.projector.intrinsics.project(before), nan=-2.0)
    at = [pixels[..., 1], pixels[..., 0]]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = 1 / map_coordinates(1 / view.depth, at, order=1, cval=np.nan)
        same = np.abs(depth - before[..., 2]) < _SAME * before[..., 2]
    return np.where(same, map_coordinates(distance, at, order=1, cval=0.0), 0.0)
