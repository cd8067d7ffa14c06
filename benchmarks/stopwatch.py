"""Time of a scan by its steps and functions, by the clock and by the processors."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import wraps
from importlib import import_module
from statistics import median
from typing import Any
from unittest.mock import patch

import numpy as np

from calib.numerics import Image
from scanner.ui import Terminal


@dataclass
class Duration:
    """Seconds by the clock, and processor seconds."""

    clock_s: float = 0.0
    processors_s: float = 0.0

    def __str__(self) -> str:
        return f"{self.clock_s:.2f} ({self.processors_s:.2f})"


@dataclass
class Stopwatch(Terminal):
    """A terminal that records the time of each step, and of each `watched` function in it.

    `matched`: the number of matches.
    """

    steps: dict[str, Duration] = field(default_factory=dict)
    parts: dict[str, dict[str, Duration]] = field(default_factory=lambda: defaultdict(dict))
    matched: int = 0

    def __post_init__(self) -> None:
        super().__init__(quiet=True)
        self._step = ""

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        self._step = what
        with measured(self.steps, what):
            yield

    @contextmanager
    def watched(
        self,
        alone: Mapping[str, str],
        beside: Mapping[str, str],
        parts: MutableMapping[str, Callable[..., Any]],
        prefix: str,
    ) -> Iterator[None]:
        """Record the time of functions, under readable names.

        `alone`: functions that run alone, as "module.name" of the calling module. `beside`: functions that run in
        threads beside others, so that only the processor time of their own thread is known; `parts`: likewise, but
        looked up in this table when they are called, whose names get a `prefix`.
        """
        with ExitStack() as patches:
            for targets, processors in ((alone, time.process_time), (beside, time.thread_time)):
                for name, target in targets.items():
                    module, _, attribute = target.rpartition(".")
                    function = getattr(import_module(module), attribute)
                    patches.enter_context(patch(target, self._timed(name, function, processors)))
            timed = {name: self._timed(prefix + name, part, time.thread_time) for name, part in parts.items()}
            patches.enter_context(patch.dict(parts, timed))
            yield

    def rest(self, step: str) -> Duration:
        """Time of a step without the functions in it, none of which may run in parallel."""
        of_parts = self.parts[step].values()
        return Duration(
            self.steps[step].clock_s - sum(part.clock_s for part in of_parts),
            self.steps[step].processors_s - sum(part.processors_s for part in of_parts),
        )

    def _timed(self, name: str, function: Callable[..., Any], processors: Callable[[], float]) -> Callable[..., Any]:
        @wraps(function)
        def timed(*arguments: Any, **options: Any) -> Any:
            with measured(self.parts[self._step], name, processors):
                return function(*arguments, **options)

        return timed


@contextmanager
def measured(
    durations: dict[str, Duration], name: str, processors: Callable[[], float] = time.process_time
) -> Iterator[None]:
    """Add the time of the block to one of the durations; `processors` returns processor seconds."""
    clock, worked = time.perf_counter(), processors()
    yield
    duration = durations.setdefault(name, Duration())
    duration.clock_s += time.perf_counter() - clock
    duration.processors_s += processors() - worked


@dataclass(frozen=True)
class PlainCopy:
    """Seconds by the clock to copy all frames, in two ways: the reference of other times.

    `in_one_piece_s`: into one piece of new memory, which the system provides each time; the minimum of several runs,
    because other work only adds to it. `frame_by_frame_s`: each frame into its own memory, the median of several runs,
    as when the limits were set; it takes half to four times as long, because the allocator may have kept the memory.
    """

    in_one_piece_s: float
    frame_by_frame_s: float


def plain_copy(frames: Sequence[Image], times: int = 5) -> PlainCopy:
    """Measure both, alternately, this many times."""
    in_one_piece_s, frame_by_frame_s = [], []
    for _ in range(times):
        begin_s = time.perf_counter()
        copies = np.empty((len(frames), *frames[0].shape), frames[0].dtype)
        for copy, frame in zip(copies, frames, strict=True):
            np.copyto(copy, frame)
        in_one_piece_s.append(time.perf_counter() - begin_s)
        del copies
        begin_s = time.perf_counter()
        each = [frame.copy() for frame in frames]
        frame_by_frame_s.append(time.perf_counter() - begin_s)
        del each
    return PlainCopy(min(in_one_piece_s), median(frame_by_frame_s))
