"""Which point does a pixel have? An index grid (H, W), `NONE` for none, and what to do where points are sparse.

Points are sparse in the camera's image where the projector's pixels are larger than the camera's and a decoder gives
one match for each of them.
"""

import cv2
import numpy as np

from calib.numerics import Ints

NONE = -1
_WINDOW_PX = 15
# From a pixel among points that are spread unevenly, the next one is rarely farther than this many spacings.
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
    """The same grid, in which pixels between sparse points have the nearest of these; holes stay holes."""
    spacing = 1 / np.sqrt(max(density(index), 1 / _WINDOW_PX**2))
    empty = (index == NONE).astype(np.uint8)
    if spacing < 1.1 or empty.all():
        return index
    distance, label = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    point_of_label = np.full(int(label.max()) + 1, NONE, np.int64)
    point_of_label[label[empty == 0]] = index[empty == 0]
    filled: Ints = np.where(distance <= _REACH_OF_SPACING * spacing, point_of_label[label], NONE)
    return filled
