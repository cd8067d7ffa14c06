"""Work shared among the machine's processors; NumPy and OpenCV let threads run side by side."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_parallel(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """What a function returns for each item, in the items' order."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(function, items))


def in_slices(count: int, size: int, work: Callable[[slice], Result]) -> list[Result]:
    """What `work` returns for slices of `size` that make up `count` elements, in order; at least one slice."""
    slices = [slice(start, min(start + size, count)) for start in range(0, max(1, count), size)]
    return [work(slices[0])] if len(slices) == 1 else in_parallel(work, slices)
