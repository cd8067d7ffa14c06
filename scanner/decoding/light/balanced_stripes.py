"""Brightness of a pattern relative to its inverse, from fine stripes of low contrast.

Within each cell of the coarser bits, a bit lights one half and its inverse the other. The mean logarithm of their ratio
over a cell is therefore that of their brightness, for any contrast and response curve; its scatter between cells gives
the uncertainty. The sum of the two, which is used where contrast is high, is uninformative where it is low.
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from calib.numerics import Bools, Floats32, Ints
from scanner.decoding.light.brightness import LEAST_DIFFERENCE, Gains
from scanner.decoding.significance import SIGNIFICANT_SIGMAS

# Fewer cells do not determine the mean's uncertainty; for high-contrast stripes the sums are more precise.
_FEWEST_CELLS, _MOST_CELLS, _FEWEST_PER_CELL = 16, 64, 32
_MOST_CONTRAST = 1.5


def gains_of_stripes(levels: Floats32, coarser: Sequence[Bools]) -> Gains | None:
    """Return the gains of a pattern and its inverse (2, P), given all coarser bits of the code, coarsest first, (P,)
    each.

    None if they are not determined or not significant.
    """
    first, second = levels
    if abs(float(np.sum(first - second))) < LEAST_DIFFERENCE / 2 * float(np.sum(first + second)):
        return None
    logs = np.log((first + 1) / (second + 1))
    if np.std(logs) > _MOST_CONTRAST:
        return None
    cell, count = _cells(coarser, len(first))
    if len(count) < _FEWEST_CELLS:
        return None
    known = cell >= 0
    means = np.bincount(cell[known], logs[known]) / count
    ratio = float(np.mean(means))
    sigma = float(np.std(means)) / sqrt(len(means))
    if abs(ratio) < SIGNIFICANT_SIGMAS * sigma:
        return None
    return Gains(np.exp(np.array([[ratio / 2], [-ratio / 2]])))


def _cells(coarser: Sequence[Bools], pixels: int) -> tuple[Ints, Ints]:
    """Return each pixel's cell index (P,), −1 for cells of few pixels, and the pixel count of each other cell."""
    words = np.zeros(pixels, np.int64)
    of_pixel, count = words, np.array([pixels])
    for bit in coarser:
        words = 2 * words + bit
        _, finer, in_finer = np.unique(words, return_inverse=True, return_counts=True)
        if len(in_finer) > _MOST_CELLS:
            break
        of_pixel, count = finer, in_finer
    full = count >= _FEWEST_PER_CELL
    number: Ints = np.where(full, np.cumsum(full) - 1, -1)
    return number[of_pixel], count[full]
