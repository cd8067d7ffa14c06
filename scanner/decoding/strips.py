"""Work on an image strip by strip: what lies between stays in the processor's cache, and all processors take part."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

_ROWS = 128


def in_strips(height: int, work: Callable[[slice], None]) -> None:
    """Call `work` with slices of rows that make up an image of `height` rows, some of them at the same time."""
    strips = [slice(start, min(start + _ROWS, height)) for start in range(0, height, _ROWS)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # The results are asked for, because an error in a strip comes with its result.
        list(pool.map(work, strips))
