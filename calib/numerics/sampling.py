"""Evenly spread samples."""

import numpy as np

from calib.numerics.array_types import Bools, Ints
from calib.numerics.jit import compiled


def evenly(chosen: Bools, size: int) -> Ints:
    """Indices of elements of a mask (N,) that are set, evenly spaced among them: all, or `size` to twice as many."""
    count = int(np.count_nonzero(chosen))
    step = max(1, count // size)
    indices = np.empty(-(-count // step), np.int64)
    _every(step, np.ascontiguousarray(chosen), indices)
    return indices


@compiled
def _every(step: int, chosen: Bools, indices: Ints) -> None:
    """The first element that is set, and every `step`-th after it."""
    number = wanted = 0
    for i in range(len(chosen)):
        if chosen[i]:
            if number == wanted:
                indices[number // step] = i
                wanted += step
            number += 1
