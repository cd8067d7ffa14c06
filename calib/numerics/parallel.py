"""Share work among processors by threads; NumPy and OpenCV release the GIL."""

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
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
    """Return a function's result for each item, in the items' order, or raise the first failed item's exception.

    One set of threads serves the whole process. What runs in one of them already shares its work no further: it would
    wait for threads that wait for it.
    """
    if getattr(_here, "is_shared", False):
        return [function(item) for item in items]
    left, found, failed = iter(list(enumerate(items))), dict[int, Result](), dict[int, BaseException]()

    # A thread takes the next item as soon as it has finished one, and wakes nobody before all are done.
    def work() -> None:
        for number, item in left:
            try:
                found[number] = function(item)
            except BaseException as error:
                failed[number] = error
            if failed:
                break

    try:
        wait([_threads(processors()).submit(work) for _ in range(processors())])
    finally:
        for _ in left:  # after an interruption nothing more is begun
            pass
    if failed:
        raise failed[min(failed)]
    return [found[number] for number in sorted(found)]


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


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)  # a forked process has none of its parent's threads
