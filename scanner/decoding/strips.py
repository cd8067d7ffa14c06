"""Work on an image strip by strip: what lies between stays in the processor's cache, and all processors take part."""

from collections.abc import Callable
from typing import TypeVar

from calib.parallel import in_slices

_ROWS = 32

Result = TypeVar("Result")


def in_strips(height: int, work: Callable[[slice], Result], rows: int = _ROWS) -> list[Result]:
    """What `work` returns for slices of so many rows that make up an image of `height`; some run at the same time."""
    return in_slices(height, rows, work)
