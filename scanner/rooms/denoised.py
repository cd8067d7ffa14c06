"""What a station sees of its planes, with the noise of single matches taken off.

How far a plane's points are from it is filtered in the image: each deviation is drawn to the mean of those around it
as far as these vary no more than noise does (Lee, "Digital image enhancement and noise filtering by use of local
statistics", IEEE PAMI 2, 1980). So bent walls stay bent, and relief that stands out of the noise stays. In inverse
depth, where the noise of triangulation is alike near and far.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats
from scanner.rooms.contents import SolvedRoom, Station

_WINDOW = 7  # pixels
_FEWEST = 12  # points of the plane in a window
_SLACK = 1.5  # of the noise's variance: in so small a window it is estimated roughly


def denoised(room: SolvedRoom, station: Station) -> NDArray[np.float32]:
    """Its points (H, W, 3) in the camera's frame; those on no plane are as they were."""
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
    told = on & (count >= _FEWEST)
    if told.any():
        noise = _SLACK * float(np.median(variance[told]))
        kept = np.where(told, np.clip(1 - noise / np.maximum(variance, noise), 0.0, 1.0), 1.0)
        deviation = mean + kept * (deviation - mean)
    inverse = np.where(told, of_plane + deviation, 1 / depth)
    smoothed: Floats = (rays / inverse[..., None])[on]
    return smoothed


def _summed(values: Floats) -> Floats:
    """Over the window around each pixel."""
    window = (_WINDOW, _WINDOW)
    return cv2.boxFilter(values, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT).astype(np.float64)
