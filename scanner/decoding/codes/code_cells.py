"""Average the camera pixels of each projector cell, for captures where only Gray codes tell a coordinate.

All camera pixels with one code see the same small patch; its centre is known better than any of them.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.numerics import Bools, Floats, Floats32, Image, Ints, compiled

# Largest mean square radius of a code's pixels, in pixels²: this plus the median number of pixels per cell (a compact
# patch has a sixth of its number, a stripe of four times its width a third).
_SMALLEST_SPREAD = 1.0
# A cell with many fewer pixels than the fullest around it is cut off, and its pixels' mean is not its centre. The side
# of a whole cell varies by a pixel, from sampling, and by this share of it, from perspective and shading; cells of
# fewer than `_COUNTABLE` pixels are not tested.
_VARYING_PX, _VARYING = 1.0, 0.13
_COUNTABLE = 6


@dataclass(frozen=True)
class CellMatches:
    """M matches of cells with each other's centres."""

    camera_px: Floats
    """(M, 2)"""
    projector_px: Floats
    """(M, 2)"""
    variance: Floats
    """(M,): of each projector coordinate."""
    rejected: Bools
    """(H, W): pixels of cut-off cells, or of a code that also occurs elsewhere, so that one occurrence is wrong."""


def average_cells(
    kept: Bools, cell_px: Floats32, projector_px: Floats32, variance: Floats32, brightness: Image
) -> CellMatches:
    """Average the `kept` pixels (H, W) whose cells have the same centre `cell_px` (H, W, 2), weighted by `brightness`.

    `projector_px` (H, W, 2): their coordinates, which differ from the centre by a motion that was taken back. Cells are
    told apart by half a pixel.
    """
    rejected = np.zeros(kept.shape, np.bool_)
    if not kept.any():
        return CellMatches(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), rejected)
    half_px, pixels = np.empty((2, np.count_nonzero(kept), 2), np.int32)
    _list_pixels(kept, cell_px, half_px, pixels)
    (across, number_x), (down, number_y) = (_numbered(half_px[:, axis]) for axis in (0, 1))
    group = number_y[half_px[:, 1]] * np.int32(len(across)) + number_x[half_px[:, 0]]
    counts = np.bincount(group, minlength=len(across) * len(down))
    cells = np.flatnonzero(counts)
    cell_y, cell_x = np.divmod(cells, len(across))
    number = np.empty(len(counts), np.int32)
    number[cells] = np.arange(len(cells), dtype=np.int32)
    group, count = number[group], counts[cells]

    weight, of_variance, square = np.zeros((3, len(cells)))
    camera_px, shift_px, middle_px = np.zeros((3, len(cells), 2))
    of_pixels = pixels, group, brightness.astype(np.float32), variance, half_px, projector_px
    _add_up(*of_pixels, weight, camera_px, shift_px, middle_px, square, of_variance)
    camera_px /= weight[:, None]
    shift_px /= weight[:, None]
    middle_px /= count[:, None]
    spread = square / count + np.sum((camera_px - middle_px) ** 2 - middle_px**2, axis=1)
    good = spread <= _SMALLEST_SPREAD + np.median(count)
    good &= _is_whole(cell_x, cell_y, count)
    rejected[kept] = ~good[group]
    centre_px = np.stack([across[cell_x], down[cell_y]], axis=1) + shift_px
    return CellMatches(camera_px[good], centre_px[good], (of_variance / count**2)[good], rejected)


def _numbered(half_px: Ints) -> tuple[Floats, Ints]:
    """Return the distinct cell centres, ascending, and a table of their indices by half-pixel coordinate.

    `half_px` (N,). Like numpy.unique, without sorting millions of numbers.
    """
    there = np.bincount(half_px) > 0
    number: Ints = np.cumsum(there, dtype=np.int32) - np.int32(1)
    return (np.flatnonzero(there) - 1) / 2.0, number


@compiled
def _list_pixels(kept: Bools, cell_px: Floats32, half_px: Ints, pixels: Ints) -> None:
    """List the kept pixels, (N, 2) each: centres of cells in half pixels, counted from −0.5; camera column and row."""
    height, width = kept.shape
    n = 0
    for row in range(height):
        for column in range(width):
            if kept[row, column]:
                for axis in range(2):
                    half_px[n, axis] = int(2 * cell_px[row, column, axis] + 1.5)
                pixels[n, 0], pixels[n, 1] = column, row
                n += 1


@compiled
def _add_up(
    pixels: Ints,
    group: Ints,
    brightness: Floats32,
    variance: Floats32,
    half_px: Ints,
    projector_px: Floats32,
    weight: Floats,
    camera_px: Floats,
    shift_px: Floats,
    middle_px: Floats,
    square: Floats,
    of_variance: Floats,
) -> None:
    """Sum weights, weighted pixels and shifts, pixels, their squares and variances by group."""
    for n in range(len(group)):
        (column, row), into = pixels[n], group[n]
        by = brightness[row, column] + 1.0
        weight[into] += by
        camera_px[into, 0] += by * column
        camera_px[into, 1] += by * row
        for axis in range(2):
            shift_px[into, axis] += by * (projector_px[row, column, axis] - (half_px[n, axis] - 1) / 2)
        middle_px[into, 0] += column
        middle_px[into, 1] += row
        square[into] += column * column + row * row
        of_variance[into] += variance[row, column]


def _is_whole(cell_x: Ints, cell_y: Ints, count: Ints) -> Bools:
    if np.median(count) < _COUNTABLE:
        return np.ones(len(count), np.bool_)
    grid = np.zeros((int(cell_y.max()) + 1, int(cell_x.max()) + 1), np.float32)
    grid[cell_y, cell_x] = count
    fullest = cv2.dilate(grid, np.ones((3, 3), np.uint8))
    side, largest = np.sqrt(count), np.sqrt(fullest[cell_y, cell_x])
    whole: Bools = side >= largest - np.maximum(_VARYING_PX, _VARYING * largest)
    return whole
