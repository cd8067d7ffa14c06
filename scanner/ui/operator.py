"""Who follows the work: the person at the rig, who is told and asked to move it, and an observer of its progress."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Protocol, TypeVar


class Operator(Protocol):
    """The operator, at a terminal or at a page in the browser."""

    @property
    def can_ask(self) -> bool:
        """Whether there is a person to answer."""

    def ready(self, what: str) -> bool:
        """Wait until a request is fulfilled; False if the operator continues without it."""

    def tell(self, *sentences: str) -> None:
        """Show sentences to the operator."""

    def note(self, text: str) -> None:
        """Show a note that matters whether or not the operation succeeds."""


T = TypeVar("T")


class Progress(Protocol):
    """Receives the progress of long operations. May raise, to stop them."""

    def track(self, items: Iterable[T], total: int, what: str) -> Iterator[T]:
        """Pass `items` on, of which there are `total`, and report their number."""

    def step(self, what: str) -> AbstractContextManager[None]:
        """Report an operation that lasts until the block ends."""
