"""Work in parts, long arrays in slices and images in tiles, shared among processors by threads.

NumPy, OpenCV and compiled loops release the GIL. Intermediate results of a part stay in the processor's cache, which is
several times as fast as whole arrays, which pass through memory for every operation.
"""

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from math import ceil
from typing import TypeVar

import numpy as np

from calib.numerics.arrays import Bools, Window

Item = TypeVar("Item")
Result = TypeVar("Result")

_PIECE = 1 << 16
_NUMBERS = 1 << 16
# Larger tiles cost memory; smaller ones cost time between the loops, where the interpreter runs one thread at a time.
_TILE_PX = (120, 1224)
STRIP_ROWS = 64  # of an image at once, where intermediate results need many times its memory

_chosen: list[int] = []


def use_processors(count: int) -> None:
    """Set the number of threads of this process; use fewer than processors if other processes run in parallel."""
    _chosen[:] = [count]


def processors() -> int:
    """Return the number of threads: as set, or the number of processors."""
    return _chosen[0] if _chosen else os.cpu_count() or 1


def in_parallel(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return a function's result for each item, in the items' order, or raise the first failed item's exception.

    One set of threads serves the whole process. What runs in one of them already shares its work no further: it would
    wait for threads that wait for it.
    """
    if getattr(_here, "is_shared", False):
        return [function(item) for item in items]
    remaining, results, failed = iter(list(enumerate(items))), dict[int, Result](), dict[int, BaseException]()

    # A thread takes the next item as soon as it has finished one, and wakes nobody before all are done.
    def work() -> None:
        for number, item in remaining:
            try:
                results[number] = function(item)
            except BaseException as error:
                failed[number] = error
            if failed:
                break

    try:
        wait([_threads(processors()).submit(work) for _ in range(processors())])
    finally:
        for _ in remaining:  # after an interruption nothing more is begun
            pass
    if failed:
        raise failed[min(failed)]
    return [results[number] for number in sorted(results)]


_here = threading.local()


@lru_cache(1)
def _threads(count: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(count, thread_name_prefix="shared", initializer=_mark)


def _mark() -> None:
    _here.is_shared = True


def in_slices(count: int, size: int, work: Callable[[slice], Result]) -> list[Result]:
    """Return the results of `work` for slices of `size` that cover `count` elements, in order; at least one slice."""
    slices = slices_of(count, size)
    return [work(slices[0])] if len(slices) == 1 else in_parallel(work, slices)


def slices_of(count: int, size: int) -> list[slice]:
    """Return slices of `size` that cover `count` elements, in order; at least one."""
    return [slice(start, min(start + size, count)) for start in range(0, max(1, count), size)]


def in_pieces(count: int, work: Callable[[slice], Result], width: int = 1) -> list[Result]:
    """Return the results of `work` for slices that cover `count` elements, in order; slices may run in parallel.

    `width`: numbers per element, if there are many.
    """
    size = _PIECE if width == 1 else max(1, _NUMBERS // max(1, width))
    return in_slices(count, size, work)


def in_tiles(shape: tuple[int, int], work: Callable[[slice, slice], Result]) -> list[Result]:
    """Return the results of `work` for rows and columns of tiles that cover an image of `shape`;
    some run in parallel.
    """
    rows, columns = (_even_slices(size, most) for size, most in zip(shape, _TILE_PX, strict=True))
    return in_parallel(lambda tile: work(*tile), [(down, across) for down in rows for across in columns])


def _even_slices(size: int, most: int) -> list[slice]:
    """Split into slices of nearly equal length, even except for the last."""
    length = 2 * ceil(size / ceil(size / most) / 2)
    return [slice(start, min(start + length, size)) for start in range(0, size, length)]


def around(pixels: Bools, margin: int = 0) -> Window:
    """Return the rows and columns that hold all the chosen pixels (H, W), at least one, and a margin."""
    spans = []
    for size, across in zip(pixels.shape, (1, 0), strict=True):
        chosen = np.flatnonzero(pixels.any(axis=across))
        spans.append(slice(max(0, int(chosen[0]) - margin), min(size, int(chosen[-1]) + 1 + margin)))
    return spans[0], spans[1]


def widened(part: slice, by: int, size: int) -> tuple[slice, slice]:
    """Widen a slice of `size` elements by up to `by` on either side; return it and the position of the original within
    it.
    """
    start, stop = max(0, part.start - by), min(size, part.stop + by)
    return slice(start, stop), slice(part.start - start, part.stop - start)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)  # a forked process has none of its parent's threads
