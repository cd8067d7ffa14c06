"""Process an image part by part, so that intermediate results stay in the cache and all processors take part."""

from collections.abc import Callable
from math import ceil
from typing import TypeVar

import numpy as np

from calib.numerics import Bools, in_parallel, in_slices
from scanner.decoding.arrays import Window

# Larger tiles cost memory; smaller ones cost time between the loops, where the interpreter runs one thread at a time.
_TILE_PX = (120, 1224)
STRIP_ROWS = 64  # of an image at once, where intermediate results need many times its memory

Result = TypeVar("Result")


def in_strips(height: int, rows: int, work: Callable[[slice], Result]) -> list[Result]:
    """Return the results of `work` for slices of `rows` rows that cover an image of `height`; some run in parallel."""
    return in_slices(height, rows, work)


def in_tiles(shape: tuple[int, int], work: Callable[[slice, slice], Result]) -> list[Result]:
    """Return the results of `work` for rows and columns of tiles that cover an image of `shape`;
    some run in parallel.
    """
    rows, columns = (_parts(size, most) for size, most in zip(shape, _TILE_PX, strict=True))
    return in_parallel(lambda tile: work(*tile), [(down, across) for down in rows for across in columns])


def _parts(size: int, most: int) -> list[slice]:
    """Split into parts of nearly equal size, even except for the last."""
    length = 2 * ceil(size / ceil(size / most) / 2)
    return [slice(start, min(start + length, size)) for start in range(0, size, length)]


def around(pixels: Bools, margin: int = 0) -> Window:
    """Return the rows and columns that hold all the chosen pixels (H, W), at least one, and a margin."""
    spans = []
    for size, across in zip(pixels.shape, (1, 0), strict=True):
        found = np.flatnonzero(pixels.any(axis=across))
        spans.append(slice(max(0, int(found[0]) - margin), min(size, int(found[-1]) + 1 + margin)))
    return spans[0], spans[1]


def widened(part: slice, by: int, size: int) -> tuple[slice, slice]:
    """Widen a slice of `size` elements by up to `by` on either side; return it and the position of the original within
    it.
    """
    start, stop = max(0, part.start - by), min(size, part.stop + by)
    return slice(start, stop), slice(part.start - start, part.stop - start)
