"""Work on an image part by part: what lies between stays in the processor's cache, and all processors take part."""

from collections.abc import Callable
from math import ceil
from typing import TypeVar

from calib.numerics import in_parallel, in_slices

# Larger ones would cost memory, smaller ones time between the loops: the interpreter serves one thread only, and the
# other one sleeps for it.
_TILE_PX = (120, 1224)

Result = TypeVar("Result")


def in_strips(height: int, rows: int, work: Callable[[slice], Result]) -> list[Result]:
    """What `work` returns for slices of so many rows that make up an image of `height`; some run at the same time."""
    return in_slices(height, rows, work)


def in_tiles(shape: tuple[int, int], work: Callable[[slice, slice], Result]) -> list[Result]:
    """What `work` returns for rows and columns of tiles that make up an image of `shape`; some run at the same time."""
    rows, columns = (_parts(size, most) for size, most in zip(shape, _TILE_PX, strict=True))
    return in_parallel(lambda tile: work(*tile), [(down, across) for down in rows for across in columns])


def _parts(size: int, most: int) -> list[slice]:
    """Parts of nearly the same size, an even one but for the last."""
    length = 2 * ceil(size / ceil(size / most) / 2)
    return [slice(start, min(start + length, size)) for start in range(0, size, length)]


def widened(part: slice, by: int, size: int) -> tuple[slice, slice]:
    """A slice of `size` elements with so many more on either side as there are, and where it is itself in these."""
    start, stop = max(0, part.start - by), min(size, part.stop + by)
    return slice(start, stop), slice(part.start - start, part.stop - start)
