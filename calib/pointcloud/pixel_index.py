"""Index grids (H, W): the point of each pixel, `NONE` for none; and filling gaps between sparse points.

Points are sparse in the camera's image if the projector's pixels are larger than the camera's and a decoder returns one
match for each.
"""

import cv2
import numpy as np

from calib.numerics import Ints

NONE = -1
_WINDOW_PX = 15
# Among unevenly spaced points, the next one is rarely farther than this many spacings.
_REACH_OF_SPACING = 1.5


def index_grid(pixel: Ints, size: tuple[int, int]) -> Ints:
    """The grid of points at pixels (N, 2), column and row, in an image of `size` (width, height)."""
    grid = np.full(size[::-1], NONE, np.int32)
    grid[pixel[:, 1], pixel[:, 0]] = np.arange(len(pixel), dtype=np.int32)
    return grid


def density(index: Ints) -> float:
    """Points per pixel where there are points: nearly 1 if every pixel has one; 0 for none."""
    there = index != NONE
    if not there.any():
        return 0.0
    size = (_WINDOW_PX, _WINDOW_PX)
    around = cv2.boxFilter(there.astype(np.float32), cv2.CV_32F, size, normalize=True, borderType=cv2.BORDER_CONSTANT)
    return float(np.median(np.asarray(around)[there]))


def without_gaps(index: Ints) -> Ints:
    """The same grid with pixels between sparse points assigned to the nearest point; holes stay holes."""
    spacing = 1 / np.sqrt(max(density(index), 1 / _WINDOW_PX**2))
    empty = (index == NONE).astype(np.uint8)
    if spacing < 1.1 or empty.all():
        return index
    distance, label = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    point_of_label = np.full(int(label.max()) + 1, NONE, np.int64)
    point_of_label[label[empty == 0]] = index[empty == 0]
    return np.where(distance <= _REACH_OF_SPACING * spacing, point_of_label[label], NONE)
