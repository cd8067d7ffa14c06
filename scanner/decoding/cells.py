"""One measurement per projector cell, for captures where only Gray codes tell a coordinate.

All camera pixels with one code see the same small patch; its centre is better known than any of them is.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.arrays import Bools, Floats, Image, Ints
from scanner.decoding.arrays import Floats32

# Mean square radius of the pixels of one code, in pixels²: at most this much plus the usual number of pixels (a compact
# patch has a sixth of that number, a stripe of four times its width a third).
_SMALLEST_SPREAD = 1.0
# A cell of several pixels that has this much fewer than the fullest around it is cut off, and its centre is not the
# cell's. Below `_COUNTABLE` pixels the numbers vary too much by themselves.
_WHOLE = 0.75
_COUNTABLE = 6


@dataclass(frozen=True)
class CellMatches:
    """`camera_px`, `projector_px` (M, 2), `variance` (M,) of each projector coordinate.

    `rejected` (H, W): pixels whose code also turns up elsewhere, so that one of them is wrong, or of cut-off cells.
    """

    camera_px: Floats
    projector_px: Floats
    variance: Floats
    rejected: Bools


def average_cells(kept: Bools, projector_px: Floats32, variance: Floats32, brightness: Image) -> CellMatches:
    """Average the `kept` pixels (H, W) that share their `projector_px` (H, W, 2), weighted by `brightness` (H, W)."""
    rejected = np.zeros(kept.shape, np.bool_)
    row, column = np.nonzero(kept)
    if not len(row):
        return CellMatches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), rejected)
    across, cell_x = _numbered(projector_px[..., 0][kept])
    down, cell_y = _numbered(projector_px[..., 1][kept])
    cell_of_pixel = cell_y * len(across) + cell_x
    counts = np.bincount(cell_of_pixel, minlength=len(across) * len(down))
    cells = np.flatnonzero(counts)
    number = np.empty(len(counts), np.int64)
    number[cells] = np.arange(len(cells))
    group, count = number[cell_of_pixel], counts[cells]
    cell_y, cell_x = np.divmod(cells, len(across))

    weight = brightness[kept].astype(np.float64) + 1
    total = np.bincount(group, weight)
    camera_px = np.stack([np.bincount(group, weight * along) / total for along in (column, row)], axis=1)
    square = (column - camera_px[group, 0]) ** 2 + (row - camera_px[group, 1]) ** 2
    good = np.bincount(group, square) / count <= _SMALLEST_SPREAD + np.median(count)
    good &= _is_whole(cell_x, cell_y, count)
    rejected[row, column] = ~good[group]
    centre_px = np.stack([across[cell_x], down[cell_y]], axis=1)
    of_cell = np.bincount(group, variance[kept]) / count
    return CellMatches(camera_px[good], centre_px[good], (of_cell / count)[good], rejected)


def _numbered(centres: Floats32) -> tuple[Floats, Ints]:
    """The different centres of cells, rising, and the number among them of each of `centres` (N,).

    Like numpy.unique, without sorting millions of numbers: centres are whole numbers of half pixels.
    """
    halves = np.rint(2 * centres).astype(np.int32)
    first = int(halves.min())
    halves -= first
    there = np.flatnonzero(np.bincount(halves))
    number = np.zeros(there[-1] + 1, np.int64)
    number[there] = np.arange(len(there))
    return (there + first) / 2.0, number[halves]


def _is_whole(cell_x: Ints, cell_y: Ints, count: Ints) -> Bools:
    if np.median(count) < _COUNTABLE:
        return np.ones(len(count), np.bool_)
    grid = np.zeros((int(cell_y.max()) + 1, int(cell_x.max()) + 1), np.float32)
    grid[cell_y, cell_x] = count
    fullest = cv2.dilate(grid, np.ones((3, 3), np.uint8))
    whole: Bools = count >= _WHOLE * fullest[cell_y, cell_x]
    return whole
