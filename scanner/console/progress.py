"""Progress of what the worker does, for the page; and the place where it is stopped when the operator cancels."""

import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event
from typing import TypeVar

from hw.rig import Frame

T = TypeVar("T")

log = logging.getLogger(__name__)


class CancelledError(Exception):
    """The operator does not want this any more."""


@dataclass(frozen=True)
class Stage:
    """What is being done now; `done` of `total` things, or 0 of 0 where they cannot be counted."""

    what: str
    done: int = 0
    total: int = 0

    @property
    def percent(self) -> float:
        """From 0 to 100."""
        return 100.0 * self.done / self.total if self.total else 0.0


class StagedProgress:
    """`scanner.ui.progress.Progress` for a page: tells `on_stage`, and shows frames that go by to `on_frame`.

    Raises CancelledError between two frames, and before a step, once `cancelled` is set.
    """

    def __init__(self, cancelled: Event, on_stage: Callable[[Stage], None], on_frame: Callable[[Frame], None]) -> None:
        self._cancelled = cancelled
        self._on_stage = on_stage
        self._on_frame = on_frame

    def track(self, items: Iterable[T], total: int, what: str) -> Iterator[T]:
        """Pass `items` on, and tell how many went by."""
        log.info("%s: %d", what, total)
        self._tell(Stage(what, 0, total))
        for done, item in enumerate(items, start=1):
            if isinstance(item, tuple) and isinstance(item[-1], Frame):  # (pattern, frame)
                self._on_frame(item[-1])
            yield item
            self._tell(Stage(what, done, total))

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        """Tell what is being done."""
        log.info("%s", what)
        self._tell(Stage(what))
        yield

    def _tell(self, stage: Stage) -> None:
        if self._cancelled.is_set():
            raise CancelledError("cancelled")
        self._on_stage(stage)
