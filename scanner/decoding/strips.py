"""Work on an image strip by strip: what lies between stays in the processor's cache, and all processors take part."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_ROWS = 32

Result = TypeVar("Result")


def in_strips(height: int, work: Callable[[slice], Result], rows: int = _ROWS) -> list[Result]:
    """What `work` returns for slices of so many rows that make up an image of `height`; some run at the same time."""
    strips = [slice(start, min(start + rows, height)) for start in range(0, height, rows)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(work, strips))
