"""Pixels that do not continue the surface that their neighbours see.

At an occlusion edge a pixel sees two surfaces and its phase is that of neither; an error in a code is an island. Both
break the map from camera to projector, which is smooth on a surface.
"""

from math import sqrt

import cv2
import numpy as np

from calib.arrays import Bools
from scanner.decoding.arrays import Floats32
from scanner.decoding.coordinate import Coordinate
from scanner.decoding.strips import in_strips

_SIGMAS = 5.0
# A surface may bend by this much of its slope, and this many projector pixels, from one camera pixel to the next.
_BEND_OF_SLOPE = 0.5
_BEND_PX = 1.0
_SMALLEST_PATCH = 24
# Where the amplitude halves from one pixel to the next, the lens shifts the coordinate by up to half a pixel.
_FAINTER = 2.0


def isolated(kept: Bools, coordinates: tuple[Coordinate, ...], cells: tuple[float, ...]) -> Bools:
    """Which of the `kept` pixels (H, W) break the map of any axis, or are left on small patches between breaks.

    `cells`: per axis, the steps in which its coordinate comes; 0 for one with fringes.
    """
    broken = np.zeros(kept.shape, np.bool_)

    def find_breaks(rows: slice) -> None:
        above, below = min(rows.start, 1), min(len(kept) - rows.stop, 1)
        wider = slice(rows.start - above, rows.stop + below)
        inner = slice(above, above + rows.stop - rows.start)
        for coordinate, cell in zip(coordinates, cells, strict=True):
            value = np.where(kept[wider], coordinate.value[wider], np.float32(np.nan))
            variance = coordinate.variance[wider]
            slack = np.full_like(variance, 2 * cell) if cell else np.float32(_SIGMAS * sqrt(6)) * np.sqrt(variance)
            breaks = _bends(value, slack)
            if not cell:
                breaks |= _is_faint(variance)
            broken[rows] |= breaks[inner]

    in_strips(len(kept), find_breaks)
    _, patches, stats, _ = cv2.connectedComponentsWithStats((kept & ~broken).astype(np.uint8), connectivity=4)
    is_large = stats[:, cv2.CC_STAT_AREA] >= _SMALLEST_PATCH
    is_large[0] = False
    result: Bools = kept & ~is_large[patches]
    return result


def _bends(value: Floats32, slack: Floats32) -> Bools:
    """Where the second difference along a row or a column is more than curvature and `slack` explain.

    A neighbour that is NaN explains nothing and breaks nothing.
    """
    broken = np.zeros(value.shape, np.bool_)
    for before, middle, after in (
        (np.s_[:-2, :], np.s_[1:-1, :], np.s_[2:, :]),
        (np.s_[:, :-2], np.s_[:, 1:-1], np.s_[:, 2:]),
    ):
        bend = np.abs(value[before] + value[after] - 2 * value[middle])
        slope = np.abs(value[after] - value[before]) / 2
        broken[middle] |= bend > _BEND_PX + _BEND_OF_SLOPE * slope + slack[middle]
    return broken


def _is_faint(variance: Floats32) -> Bools:
    """Where the fringes are much weaker than next door.

    At the edge of the light, or of a dark patch, the lens mixes in light from beside the pixel.
    """
    smallest = cv2.erode(variance, np.ones((3, 3), np.uint8))
    faint: Bools = np.asarray(variance > _FAINTER**2 * smallest, np.bool_)
    return faint
