"""The interface by which the pipeline reports its progress to an observer."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

T = TypeVar("T")


class Progress(Protocol):
    """Receives the progress of long operations. May raise, to stop them."""

    def track(self, items: Iterable[T], total: int, what: str) -> Iterator[T]:
        """Pass `items` on, of which there are `total`, and report their number."""

    def step(self, what: str) -> AbstractContextManager[None]:
        """Report an operation that lasts until the block ends."""
