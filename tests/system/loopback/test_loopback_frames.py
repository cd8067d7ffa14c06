"""Which frames a camera attributes to earlier exposures."""

import time
from collections import deque
from types import SimpleNamespace
from typing import Any

import pytest

from hw.aravis import backend as aravis

EXPOSURE_S = 0.05
TOLD_S = 0.02


class Buffer:
    """A frame whose first packet arrives now."""

    def __init__(self) -> None:
        self.came_ns = time.time_ns()

    def get_system_timestamp(self) -> int:
        return self.came_ns


class Stream:
    """Frames that arrive at given times (monotonic clock)."""

    def __init__(self, moments: list[float]) -> None:
        self._moments = deque(moments)
        self.given_back: list[Any] = []

    def try_pop_buffer(self) -> Buffer | None:
        if not self._moments or time.monotonic() < self._moments[0]:
            return None
        self._moments.popleft()
        return Buffer()

    def timeout_pop_buffer(self, timeout_us: int) -> Buffer | None:
        time.sleep(min(timeout_us / 1e6, 0.001))
        return self.try_pop_buffer()

    def push_buffer(self, buffer: Any) -> None:
        self.given_back.append(buffer)


@pytest.mark.parametrize(
    ("after_s", "theirs"), [([EXPOSURE_S + 0.002], 0), ([0.03, EXPOSURE_S + 0.002], 1), ([EXPOSURE_S + 0.04], 0)]
)
def test_a_frame_before_a_late_trigger_confirmation_is_kept(after_s: list[float], theirs: int) -> None:
    """A camera that confirms a trigger late may have obeyed at once: its frame may arrive before the confirmation."""
    camera = object.__new__(aravis.load().AravisCamera)
    camera._disturbed = camera._free_running = False
    camera._arrived = None
    camera.exposure_s = EXPOSURE_S
    camera._camera = SimpleNamespace(software_trigger=lambda: time.sleep(TOLD_S))
    camera._stream = stream = Stream([time.monotonic() + seconds for seconds in after_s])
    begin_s = time.monotonic()
    camera.expose()
    assert EXPOSURE_S + TOLD_S <= time.monotonic() - begin_s < EXPOSURE_S + TOLD_S + 0.4
    assert len(stream.given_back) == theirs
    assert camera._arrived is not None or camera._pop(1.0) is not None
