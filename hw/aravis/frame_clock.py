"""Converts time stamps of a free-running or externally triggered camera to this computer's clock."""

from collections import deque

_LATELY = 64  # frames, over which the clocks drift apart by less than a millisecond
_INTERVALS = 16


class FrameClock:
    """Estimates the offset between both clocks from the arrival times of frames.

    A frame is assumed to arrive right after its exposure. Readout makes all begins late by the same amount, which
    cancels because latencies are measured and awaited with the same times.
    """

    def __init__(self) -> None:
        self._delays_s: deque[float] = deque(maxlen=_LATELY)  # arrival minus exposure minus time stamp
        self._intervals_s: deque[float] = deque(maxlen=_INTERVALS)
        self._last: tuple[int, float] | None = None

    @property
    def has_time_stamps(self) -> bool:
        """Whether the camera delivers time stamps."""
        return bool(self._intervals_s)

    @property
    def interval_s(self) -> float:
        """The longest recent time from one frame to the next; infinite if unknown."""
        return max(self._intervals_s, default=float("inf"))

    def begun_s(self, number: int, stamp_s: float, came_s: float, exposure_s: float) -> float:
        """When the exposure of a frame began (monotonic clock). The smallest recent delay is used, so a delayed
        frame does not count.

        `stamp_s`: by the camera's clock. `came_s`: arrival of the first packet by the monotonic clock.
        """
        if self._last is not None and number == self._last[0] + 1 and stamp_s > self._last[1]:
            self._intervals_s.append(stamp_s - self._last[1])
        self._last = number, stamp_s
        self._delays_s.append(came_s - exposure_s - stamp_s)
        return stamp_s + min(self._delays_s)
