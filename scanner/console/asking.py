"""The operator at the page: learns what captures add, and is asked to move the rig between them."""

from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Event

from scanner.console.progress import CancelledError

_LOOKED_EVERY_S = 0.2


class PageOperator:
    """A `scanner.ui.Operator`. `on_asked` receives the message and the question ('' for none)."""

    can_ask = True

    def __init__(self, cancelled: Event, on_asked: Callable[[tuple[str, ...], str], None]) -> None:
        self._cancelled, self._on_asked = cancelled, on_asked
        self._sentences: tuple[str, ...] = ()
        self._answers: SimpleQueue[bool] = SimpleQueue()

    def tell(self, *sentences: str) -> None:
        """Show a message until the next one."""
        self._sentences = sentences
        self._on_asked(sentences, "")

    def note(self, text: str) -> None:
        """Show it as well."""
        self.tell(*self._sentences, text)

    def ready(self, what: str) -> bool:
        """Wait for one of two buttons. Raises CancelledError."""
        while not self._answers.empty():
            self._answers.get()  # of buttons that were pressed twice
        self._on_asked(self._sentences, what)
        while not self._cancelled.is_set():
            try:
                more = self._answers.get(timeout=_LOOKED_EVERY_S)
            except Empty:
                continue
            self.tell()
            return more
        raise CancelledError("cancelled")

    def answer(self, *, more: bool) -> None:
        """A button was pressed."""
        self._answers.put(more)
