"""The person at the rig, who receives messages, and is asked to move it."""

from typing import Protocol


class Operator(Protocol):
    """The operator, at a terminal or at a page in the browser."""

    @property
    def can_ask(self) -> bool:
        """Whether there is a person to answer."""

    def ready(self, what: str) -> bool:
        """Wait until what is asked for in a sentence is done; False if the operator goes on with what there is."""

    def tell(self, *sentences: str) -> None:
        """Show sentences to the operator."""

    def note(self, text: str) -> None:
        """Say what is to be known whether or not what is being done succeeds."""
