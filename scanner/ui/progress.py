"""The interface by which the pipeline reports its progress to an observer."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar

T = TypeVar("T")


class Progress(Protocol):
    """Told of everything that takes a while. May raise, to have it stopped there."""

    def track(self, items: Iterable[T], total: int, what: str) -> Iterator[T]:
        """Pass `items` on, of which there are `total`, and tell how many went by."""

    def step(self, what: str) -> AbstractContextManager[None]:
        """Tell what is being done for as long as the block runs."""
