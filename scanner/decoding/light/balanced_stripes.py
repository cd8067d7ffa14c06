"""How bright a pattern is next to its inverse, from stripes that are fine: nothing else tells where they are weak, too.

Inside each cell that coarser bits leave, a bit lights up one half and its inverse the other. Over a cell the mean
logarithm of their ratio is therefore that of their brightness, whatever contrast the lenses leave and however the
camera answers to light, and how far cells differ says how well it is known. The sum of the two, which tells where
contrast is high, is the same everywhere where it is low.
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

from calib.numerics import Bools, Ints
from scanner.decoding.arrays import Floats32
from scanner.decoding.light.brightness import LEAST_DIFFERENCE, Gains
from scanner.decoding.significance import SIGNIFICANT_SIGMAS

# Fewer cells do not tell how well the mean is known; stripes of much contrast are told better by their sums.
_FEWEST_CELLS, _MOST_CELLS, _FEWEST_PER_CELL = 16, 64, 32
_MOST_CONTRAST = 1.5


def gains_of_stripes(levels: Floats32, coarser: Sequence[Bools]) -> Gains | None:
    """Those of a pattern and its inverse (2, P), given all coarser bits of the code, the coarsest first, (P,) each.

    None if the pixels do not tell.
    """
    first, second = levels
    if abs(float(np.sum(first - second))) < LEAST_DIFFERENCE / 2 * float(np.sum(first + second)):
        return None
    cell, count = _cells(coarser, len(first))
    if len(count) < _FEWEST_CELLS:
        return None
    known = cell >= 0
    logs, cell = np.log((first[known] + 1) / (second[known] + 1)).astype(np.float64), cell[known]
    means = np.bincount(cell, logs) / count
    contrast = sqrt(float(np.mean((logs - means[cell]) ** 2)))
    ratio = float(np.mean(means))
    sigma = float(np.std(means)) / sqrt(len(means))
    if contrast > _MOST_CONTRAST or abs(ratio) < SIGNIFICANT_SIGMAS * sigma:
        return None
    return Gains(np.exp(np.array([[ratio / 2], [-ratio / 2]])))


def _cells(coarser: Sequence[Bools], pixels: int) -> tuple[Ints, Ints]:
    """The number of each pixel's cell (P,), −1 of one that holds few, and how many pixels each of the others holds."""
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
