"""A station's view of its planes, with reduced noise.

The deviations from a plane are filtered in the image: each is moved to the mean of its neighbours as far as their
variance is that of noise (Lee, "Digital image enhancement and noise filtering by use of local statistics", IEEE PAMI 2,
1980). So bent walls stay bent, and relief above the noise stays. The filter works on inverse depth, where the noise of
triangulation does not depend on the distance.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats
from scanner.rooms.contents import SolvedRoom, Station

_WINDOW = 7  # pixels
_FEWEST = 12  # points of the plane in a window
_SLACK = 1.5  # factor on the noise variance, which a small window estimates roughly


def denoised(room: SolvedRoom, station: Station) -> NDArray[np.float32]:
    """The station's points (H, W, 3) in the camera's frame; those on no plane are unchanged."""
    points, there = station.cloud.points.copy(), station.cloud.there
    for number in np.unique(station.plane[there & (station.plane >= 0)]):
        on = there & (station.plane == number)
        around = cv2.boundingRect(on.view(np.uint8))
        part = slice(around[1], around[1] + around[3]), slice(around[0], around[0] + around[2])
        plane, place = room.planes[int(number)], station.place
        offset = plane.offset - float(plane.normal @ place.translation)
        points[part][on[part]] = _smoothed(points[part], on[part], place.rotation.T @ plane.normal / offset)
    return points


def _smoothed(points: NDArray[np.float32], on: Bools, plane: Floats) -> Floats:
    """The points that are `on` a plane X · `plane` = 1, (N, 3), of a part of an image, (h, w, 3)."""
    depth = np.where(on, points[..., 2], 1.0).astype(np.float64)
    rays = np.where(on[..., None], points, 0.0) / depth[..., None]
    of_plane = rays @ plane
    deviation = np.where(on, 1 / depth - of_plane, 0.0)
    count = _summed(on.astype(np.float64))
    several = np.maximum(count, 2.0)
    mean = _summed(deviation) / several
    variance = np.maximum(_summed(deviation**2) / several - mean**2, 0.0) * several / (several - 1)
    supported = on & (count >= _FEWEST)
    if supported.any():
        noise = _SLACK * float(np.median(variance[supported]))
        kept = np.where(supported, np.clip(1 - noise / np.maximum(variance, noise), 0.0, 1.0), 1.0)
        deviation = mean + kept * (deviation - mean)
    inverse = np.where(supported, of_plane + deviation, 1 / depth)
    return (rays / inverse[..., None])[on]


def _summed(values: Floats) -> Floats:
    """Over the window around each pixel."""
    window = (_WINDOW, _WINDOW)
    return cv2.boxFilter(values, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT).astype(np.float64)
