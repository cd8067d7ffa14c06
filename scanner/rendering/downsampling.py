"""Maps of millions of pixels, reduced for a page."""

from math import ceil, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints, compiled

Map = NDArray[np.float32]

_CANDIDATES = 16
_GOLDEN_RATIO, _MIXER, _SHIFT = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(30)


@compiled
def averaged(values: Map, size: tuple[int, int]) -> Map:
    """A map (H, W), NaN for none, reduced to `size` = (width, height) by averaging valid values.

    A pixel counts by its overlap with the new one.
    """
    reduced = np.empty((size[1], size[0]), np.float32)
    row_step, column_step = values.shape[0] / reduced.shape[0], values.shape[1] / reduced.shape[1]
    for row in range(reduced.shape[0]):
        top, bottom = row * row_step, min((row + 1) * row_step, values.shape[0])
        for column in range(reduced.shape[1]):
            left, right = column * column_step, min((column + 1) * column_step, values.shape[1])
            total, weight = 0.0, 0.0
            for y in range(int(top), int(np.ceil(bottom))):
                height = min(y + 1, bottom) - max(y, top)
                for x in range(int(left), int(np.ceil(right))):
                    if np.isfinite(values[y, x]):
                        area = height * (min(x + 1, right) - max(x, left))
                        total += area * values[y, x]
                        weight += area
            reduced[row, column] = total / weight if weight > 0 else np.nan
    return reduced


def extent(values: Map) -> tuple[int, int, int, int]:
    """First and last row, first and last column of a map (H, W) in which something is finite; 0, −1, 0, −1 for none."""
    left, top, width, height = cv2.boundingRect(np.isfinite(values).view(np.uint8))
    return top, top + height - 1, left, left + width - 1


@compiled
def places_within(values: Map, limit: float, most: int) -> tuple[int, Ints]:
    """Count the numbers of a map (H, W) within ± `limit`, and return the positions of a sample of them (n,), row by
    row.

    One is drawn at random, with a fixed seed, from each of equally many stretches; equal steps would alias with the
    rows.
    """
    count = 0
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            count += abs(values[row, column]) <= limit
    stretch = max(1, -(-count // most))
    places = np.empty(-(-count // stretch), np.int64)
    drawn, met, end, chosen = 0, 0, 0, 0
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            if abs(values[row, column]) <= limit:
                if met == end:
                    chosen = met + int(_random_bits(met) % np.uint64(min(stretch, count - met)))
                    end = met + stretch
                if met == chosen:
                    places[drawn] = row * values.shape[1] + column
                    drawn += 1
                met += 1
    return count, places


@compiled
def _random_bits(number: int) -> np.uint64:
    """64 bits that seem random: SplitMix64 (Steele et al. 2014) without its last round."""
    lot = np.uint64(number + 1) * _GOLDEN_RATIO
    lot = (lot ^ (lot >> _SHIFT)) * _MIXER
    return lot ^ (lot >> _SHIFT)


@compiled
def labels_on_grid(camera_px: Floats, label: Ints, size: tuple[int, int], grid: tuple[int, int]) -> NDArray[np.uint8]:
    """Labels (N,) of pixels (N, 2) of an image of `size` on a `grid`, both (width, height): 1 more than each, or 0."""
    labels = np.zeros((grid[1], grid[0]), np.uint8)
    columns_per_pixel, rows_per_pixel = grid[0] / size[0], grid[1] / size[1]
    for i in range(len(label)):
        column = int(np.floor((camera_px[i, 0] + 0.5) * columns_per_pixel))
        row = int(np.floor((camera_px[i, 1] + 0.5) * rows_per_pixel))
        if label[i] >= 0 and 0 <= column < grid[0] and 0 <= row < grid[1]:
            labels[row, column] = label[i] + 1
    return labels


def cells_over(size: tuple[int, int], most: int) -> tuple[int, int, int]:
    """Square cells over an image of (width, height), about `most` of them: their side in pixels, rows, and columns."""
    width, height = size
    side = max(1, ceil(sqrt(width * height / most)))
    return side, ceil(height / side), ceil(width / side)


@compiled
def one_in_cells(camera_px: Floats, label: Ints, lowest: int, side: int, rows: int, columns: int) -> Ints:
    """Select one of the pixels (N, 2) with at least the `lowest` label (N,) in each cell, (rows, columns); −1 for none.

    The choice is random with a fixed seed: the first pixel of each cell, say, would alias with fringes in the image.
    Where pixels are dense, each cell has a dozen or more to choose from.
    """
    drawn = np.full((rows, columns), -1, np.int64)
    lots = np.zeros((rows, columns), np.uint64)
    stride = max(1, len(camera_px) // (_CANDIDATES * rows * columns))
    for start in range(0, len(camera_px), stride):
        lot = _random_bits(start)
        i = start + int(lot % np.uint64(stride))
        if i >= len(camera_px) or label[i] < lowest:
            continue
        column = int(np.floor((camera_px[i, 0] + 0.5) / side))
        row = int(np.floor((camera_px[i, 1] + 0.5) / side))
        if 0 <= column < columns and 0 <= row < rows and lot > lots[row, column]:
            lots[row, column], drawn[row, column] = lot, i
    return drawn
