"""Share work among processors by threads; NumPy and OpenCV release the GIL."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


_chosen: list[int] = []


def use_processors(count: int) -> None:
    """Set the number of threads of this process; use fewer than processors if other processes run in parallel."""
    _chosen[:] = [count]


def processors() -> int:
    """Return the number of threads: as set, or the number of processors."""
    return _chosen[0] if _chosen else os.cpu_count() or 1


def in_parallel(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return a function's result for each item, in the items' order."""
    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(function, items))


def in_slices(count: int, size: int, work: Callable[[slice], Result]) -> list[Result]:
    """Return the results of `work` for slices of `size` that cover `count` elements, in order; at least one slice."""
    slices = slices_of(count, size)
    return [work(slices[0])] if len(slices) == 1 else in_parallel(work, slices)


def slices_of(count: int, size: int) -> list[slice]:
    """Return slices of `size` that cover `count` elements, in order; at least one."""
    return [slice(start, min(start + size, count)) for start in range(0, max(1, count), size)]
