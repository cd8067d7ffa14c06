"""Evenly spread samples."""

import numpy as np

from calib.numerics.array_types import Bools, Ints
from calib.numerics.jit import compiled

# Multiples of it, modulo one, fill the interval evenly.
_GOLDEN_RATIO = 0.6180339887498949


def evenly(chosen: Bools, size: int) -> Ints:
    """Indices of elements of a mask (N,) that are set: all, or one of every few, `size` to twice as many.

    The distances vary, because equal ones would alias with the rows of an image.
    """
    count = int(np.count_nonzero(chosen))
    step = max(1, count // size)
    indices = np.empty(-(-count // step), np.int64)
    _every(step, count, np.ascontiguousarray(chosen), indices)
    return indices


@compiled
def _every(step: int, count: int, chosen: Bools, indices: Ints) -> None:
    """One of every `step` elements that are set, of which there are `count`."""
    number = wanted = drawn = 0
    for i in range(len(chosen)):
        if chosen[i]:
            if number == wanted:
                indices[drawn] = i
                drawn += 1
                wanted = drawn * step + int(drawn * _GOLDEN_RATIO % 1.0 * min(step, count - drawn * step))
            number += 1
