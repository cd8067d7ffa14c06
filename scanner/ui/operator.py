"""The person at the rig, who receives messages, and is asked to move it."""

from typing import Protocol


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
