"""Work shared among the machine's processors; NumPy and OpenCV let threads run side by side."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


_chosen: list[int] = []


def use_processors(count: int) -> None:
    """Share work among so many threads from now on, in this process: beside others, fewer than there are processors."""
    _chosen[:] = [count]


def processors() -> int:
    """How many threads share work: as many as were chosen, or as there are processors."""
    return _chosen[0] if _chosen else os.cpu_count() or 1


def in_parallel(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """What a function returns for each item, in the items' order."""
    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(function, items))


def in_slices(count: int, size: int, work: Callable[[slice], Result]) -> list[Result]:
    """What `work` returns for slices of `size` that make up `count` elements, in order; at least one slice."""
    slices = slices_of(count, size)
    return [work(slices[0])] if len(slices) == 1 else in_parallel(work, slices)


def slices_of(count: int, size: int) -> list[slice]:
    """Slices of `size` that make up `count` elements, in order; at least one."""
    return [slice(start, min(start + size, count)) for start in range(0, max(1, count), size)]
