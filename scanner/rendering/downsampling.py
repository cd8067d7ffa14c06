"""Maps of millions of pixels, reduced for a page, and round numbers along its axes."""

from math import ceil, floor, log10, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints, compiled

Map = NDArray[np.float32]

_CANDIDATES = 8
_GOLDEN_RATIO, _MIXER, _SHIFT = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(30)


@compiled
def averaged(values: Map, size: tuple[int, int]) -> Map:
    """A map (H, W), NaN for none, reduced to `size` = (width, height) by averaging valid values.

    A pixel counts by its overlap with the new one.
    """
    reduced = np.empty((size[1], size[0]), np.float32)
    row_step, column_step = values.shape[0] / reduced.shape[0], values.shape[1] / reduced.shape[1]
    totals, weights = np.empty(values.shape[1]), np.empty(values.shape[1])
    for row in range(reduced.shape[0]):
        totals[:], weights[:] = 0.0, 0.0
        top, bottom = row * row_step, min((row + 1) * row_step, values.shape[0])
        for y in range(int(top), int(np.ceil(bottom))):
            height, line = min(y + 1, bottom) - max(y, top), values[y]
            for x in range(len(line)):
                there = abs(line[x]) < np.inf
                totals[x] += height * line[x] if there else 0.0
                weights[x] += height if there else 0.0
        for column in range(reduced.shape[1]):
            left, right = column * column_step, min((column + 1) * column_step, values.shape[1])
            total, weight = 0.0, 0.0
            for x in range(int(left), int(np.ceil(right))):
                width = min(x + 1, right) - max(x, left)
                total += width * totals[x]
                weight += width * weights[x]
            reduced[row, column] = total / weight if weight > 0 else np.nan
    return reduced


def extent(values: Map) -> tuple[int, int, int, int]:
    """First and last row, first and last column of a map (H, W) in which something is finite; 0, −1, 0, −1 for none."""
    left, top, width, height = cv2.boundingRect(np.isfinite(values).view(np.uint8))
    return top, top + height - 1, left, left + width - 1


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
def one_in_cells(camera_px: Floats, side: int, rows: int, columns: int) -> Ints:
    """Select one of the pixels (N, 2) in each cell, (rows, columns); −1 for none.

    The choice is random with a fixed seed: the first pixel of each cell, say, would alias with fringes in the image.
    Where pixels are dense, each cell has half a dozen or more to choose from.
    """
    drawn = np.full((rows, columns), -1, np.int64)
    lots = np.zeros((rows, columns), np.uint64)
    stride = max(1, len(camera_px) // (_CANDIDATES * rows * columns))
    for start in range(0, len(camera_px), stride):
        lot = _random_bits(start)
        i = start + int(lot % np.uint64(stride))
        if i >= len(camera_px):
            continue
        column = int(np.floor((camera_px[i, 0] + 0.5) / side))
        row = int(np.floor((camera_px[i, 1] + 0.5) / side))
        if 0 <= column < columns and 0 <= row < rows and lot > lots[row, column]:
            lots[row, column], drawn[row, column] = lot, i
    return drawn


def even_ticks(low: float, high: float, most: int) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten from `low` to `high` > `low`, about `most` at most."""
    rough = (high - low) / most
    power = 10.0 ** floor(log10(rough))
    step = next(digit * power for digit in (1, 2, 5, 10) if digit * power >= rough)
    return [k * step for k in range(ceil(low / step), floor(high / step) + 1)]


def tick_text(tick: float) -> str:
    """The label of a tick."""
    return f"{tick:.6g}".replace("-", "−")
