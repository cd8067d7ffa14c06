"""Long arrays, a piece at a time: what lies between stays in the processor's cache, and all processors take part.

Several times as fast as whole arrays, which wander between processor and memory for every sum and product.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from calib.arrays import Floats

_PIECE = 1 << 16
_NUMBERS = 1 << 16

Result = TypeVar("Result")


def in_pieces(count: int, work: Callable[[slice], Result], width: int = 1) -> list[Result]:
    """What `work` returns for slices that make up `count` elements, in order; some run at the same time.

    `width`: how many numbers there are to an element, where that is many.
    """
    size = _PIECE if width == 1 else max(1, _NUMBERS // max(1, width))
    slices = [slice(start, min(start + size, count)) for start in range(0, max(1, count), size)]
    if len(slices) == 1:
        return [work(slices[0])]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(work, slices))


def by_columns(pixels: Floats) -> Floats:
    """The same (N, 2) in double precision, with each column in one piece of memory."""
    return np.asfortranarray(pixels, dtype=np.float64)
