"""Long arrays, a piece at a time: what lies between stays in the processor's cache, and all processors take part.

Several times as fast as whole arrays, which wander between processor and memory for every sum and product.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from calib.numerics.array_types import Floats
from calib.numerics.parallel import in_slices

_PIECE = 1 << 16
_NUMBERS = 1 << 16

Result = TypeVar("Result")


def in_pieces(count: int, work: Callable[[slice], Result], width: int = 1) -> list[Result]:
    """What `work` returns for slices that make up `count` elements, in order; some run at the same time.

    `width`: how many numbers there are to an element, where that is many.
    """
    size = _PIECE if width == 1 else max(1, _NUMBERS // max(1, width))
    return in_slices(count, size, work)


def by_columns(pixels: Floats) -> Floats:
    """The same (N, 2) in double precision, with each column in one piece of memory."""
    return np.asfortranarray(pixels, dtype=np.float64)
