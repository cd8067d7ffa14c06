"""Progress of what the worker does, for the page; and the place where it is stopped when the operator cancels."""

import logging
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from threading import Event
from typing import TypeVar

from hw.rig import Frame
from scanner.networks import frames_in

T = TypeVar("T")

log = logging.getLogger(__name__)

_STEP = re.compile(r"(\S+ \S+),\d+ INFO scanner\.(?:ui\.terminal|console\.progress): (.*?)(?:: \d+)?$")
_LOG_BYTES = 1 << 20


class CancelledError(Exception):
    """The operator does not want this any more."""


@dataclass(frozen=True)
class ProgressStep:
    """The current step; `done` of `total` items, or 0 of 0 where they cannot be counted.

    `began_s`: its start, by `time.monotonic`; `usual_s`: how long it took the last time, None if unknown.
    """

    what: str
    done: int = 0
    total: int = 0
    began_s: float = field(default_factory=time.monotonic, compare=False)
    usual_s: float | None = field(default=None, compare=False)

    @property
    def percent(self) -> float:
        """Return the progress from 0 to 100."""
        return 100.0 * self.done / self.total if self.total else 0.0

    def left_s(self, now_s: float) -> float | None:
        """Estimate the remaining time in seconds; None where nothing tells, as when a step outlasts its usual time."""
        elapsed_s = now_s - self.began_s
        if self.total and self.done:
            whole_s = elapsed_s * self.total / self.done if self.done < self.total else elapsed_s
        else:
            whole_s = self.usual_s or 0.0
        return whole_s - elapsed_s if whole_s > elapsed_s else None


class StagedProgress:
    """`scanner.ui.operator.Progress` for a page: tells `on_stage`, and shows frames that go by to `on_frame`.

    `durations_s` of steps by what they are called are looked up in it, and written down there. `on_captured` is called
    when the last of some frames has been taken. Raises CancelledError between two frames, and before a step, once
    `cancelled` is set.
    """

    def __init__(
        self,
        cancelled: Event,
        on_stage: Callable[[ProgressStep], None],
        on_frame: Callable[[Frame], None],
        on_captured: Callable[[], None] = lambda: None,
        durations_s: dict[str, float] | None = None,
    ) -> None:
        self._cancelled = cancelled
        self._on_stage = on_stage
        self._on_frame = on_frame
        self._on_captured = on_captured
        self._durations_s = {} if durations_s is None else durations_s

    def track(self, items: Iterable[T], total: int, what: str) -> Iterator[T]:
        """Pass `items` on, and tell how many went by."""
        log.info("%s: %d", what, total)
        began_s, frames = time.monotonic(), False
        usual_s = self._durations_s.get(what)
        self._tell(ProgressStep(what, 0, total, began_s, usual_s))
        for done, item in enumerate(items, start=1):
            for frame in frames_in(item)[:1]:
                self._on_frame(frame)
                frames = True
            yield item
            self._tell(ProgressStep(what, done, total, began_s, usual_s))
        self._durations_s[what] = time.monotonic() - began_s
        if frames:
            self._on_captured()

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        """Tell what is being done."""
        log.info("%s", what)
        stage = ProgressStep(what, usual_s=self._durations_s.get(what))
        self._tell(stage)
        yield
        self._durations_s[what] = time.monotonic() - stage.began_s

    def _tell(self, stage: ProgressStep) -> None:
        if self._cancelled.is_set():
            raise CancelledError("cancelled")
        self._on_stage(stage)


def durations_in(path: Path) -> Mapping[str, float]:
    """How long the steps of a scan took, in seconds, from its log; empty where that cannot be read."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            matched = [match.groups() for line in file.read(_LOG_BYTES).splitlines() if (match := _STEP.match(line))]
        # A damaged log may tell the zone of one line: the clock counts.
        times = [datetime.fromisoformat(when).replace(tzinfo=None) for when, _ in matched]
    except (OSError, ValueError):
        return {}
    steps = zip(matched, times, times[1:], strict=False)
    return {what: (end - begin).total_seconds() for (_, what), begin, end in steps}
