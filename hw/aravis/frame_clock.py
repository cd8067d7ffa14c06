"""When the exposures of a camera that runs freely, or on a trigger of its own, began, in the time of this computer."""

from collections import deque

_LATELY = 64  # frames; clocks drift apart by less than a millisecond meanwhile
_INTERVALS = 16


class FrameClock:
    """Compares a camera's time stamps with when its frames came.

    What lies between the begin of an exposure and the first of its frame is the exposure, and what the camera takes to
    read it out, which is taken for nothing. That makes exposures begin too late by always the same; whoever measures
    with these times, and waits by them, does not notice.
    """

    def __init__(self) -> None:
        self._delays_s: deque[float] = deque(maxlen=_LATELY)  # from a stamp to the end of its exposure, as it came
        self._intervals_s: deque[float] = deque(maxlen=_INTERVALS)
        self._last: tuple[int, float] | None = None

    @property
    def tells(self) -> bool:
        """Whether there have been time stamps."""
        return bool(self._intervals_s)

    @property
    def interval_s(self) -> float:
        """The longest lately from one frame to the next; infinite if nobody knows."""
        return max(self._intervals_s, default=float("inf"))

    def begun_s(self, number: int, stamp_s: float, came_s: float, exposure_s: float) -> float:
        """When the exposure of the frame of that number began. What held up a single frame on its way does not count.

        `stamp_s`: by the camera's clock. `came_s`: when the first of the frame was there, by the monotonic clock.
        """
        if self._last is not None and number == self._last[0] + 1 and stamp_s > self._last[1]:
            self._intervals_s.append(stamp_s - self._last[1])
        self._last = number, stamp_s
        self._delays_s.append(came_s - exposure_s - stamp_s)
        return stamp_s + min(self._delays_s)
