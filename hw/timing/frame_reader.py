"""Reads the frames of a streaming camera in a thread as they arrive, so that none waits in a queue."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from statistics import median
from threading import Condition, Thread

import numpy as np

from calib.numerics import Image
from hw.errors import DeviceError

_KEPT = 8  # frames
_INTERVALS = 64
_NOTHING_S = 4.0  # timeout for a frame
_SLICE_S = 0.1  # longest delay of Ctrl-C
# Identical frames within this time are repetitions of the driver. After it they count as new frames of a static scene
# without noise, as in well compressed video or a black picture.
_STATIC_S = 0.4
_CLOSING_S = 6.0


@dataclass(frozen=True)
class Arrival:
    """A frame with its number, counted from 0, and its time of arrival in seconds of the monotonic clock.

    `repeated`: identical to the previous frame, byte by byte.
    """

    image: Image
    number: int
    came_s: float
    timestamp_ns: int | None
    repeated: bool


class FrameReader:
    """Reads frames from construction until `close`.

    `read` returns a frame with its time stamp, or None at the end of the stream. `close` waits for the last `read`;
    then `release` is called.
    """

    def __init__(
        self, name: str, read: Callable[[], tuple[Image, int | None] | None], release: Callable[[], None]
    ) -> None:
        self._name = name
        self._read = read
        self._release = release
        self._arrived = Condition()
        self._frames: deque[Arrival] = deque(maxlen=_KEPT)
        self._intervals_s: deque[float] = deque(maxlen=_INTERVALS)
        self._error: DeviceError | None = None
        self._ending = False
        self._changed_s = 0.0
        self._late = 0
        self.repeated = 0
        self._thread = Thread(target=self._run, name="stream", daemon=True)
        self._thread.start()

    @property
    def period_s(self) -> float:
        """The median time from one frame to the next; infinite before there are two."""
        with self._arrived:
            return median(self._intervals_s) if self._intervals_s else float("inf")

    @property
    def dropped(self) -> int:
        """How many frames were dropped, estimated from gaps between arrivals."""
        return max(0, self._late)

    @property
    def newest(self) -> int:
        """The number of the newest frame, −1 before the first."""
        with self._arrived:
            return self._frames[-1].number if self._frames else -1

    def following(self, number: int) -> Arrival:
        """Wait for the first frame after this number. Frames that a driver repeats are left out.

        Raises DeviceError if none arrives, or if the stream has ended.
        """
        frame = self.following_until(number, inf)
        assert frame is not None
        return frame

    def following_until(self, number: int, until_s: float) -> Arrival | None:
        """As `following`; None if it has not arrived by `until_s` (monotonic clock)."""
        deadline_s = time.monotonic() + _NOTHING_S
        with self._arrived:
            while True:
                following = next(
                    (frame for frame in self._frames if frame.number > number and self._counts(frame)), None
                )
                if following is not None:
                    return following
                if self._error is not None:
                    raise self._error
                if time.monotonic() > deadline_s:
                    raise DeviceError(
                        f"camera {self._name}: no frame for {_NOTHING_S:.0f} s. Check that it is on and sends, its "
                        "cable or network, and that no other program uses it, then rerun."
                    )
                left_s = until_s - time.monotonic()
                if left_s <= 0:
                    return None
                self._arrived.wait(min(_SLICE_S, left_s))

    def close(self) -> None:
        """Stop reading."""
        self._ending = True
        self._thread.join(_CLOSING_S)

    def _counts(self, arrival: Arrival) -> bool:
        return not arrival.repeated or arrival.came_s - self._changed_s > _STATIC_S

    def _run(self) -> None:
        last: Arrival | None = None
        try:
            while not self._ending and (taken := self._read()) is not None:
                last = self._noted(*taken, last)
            error = DeviceError(
                f"camera {self._name}: its stream has ended. Check that it is on, its cable or network, then rerun."
            )
        except DeviceError as caught:
            error = caught
        finally:
            self._release()
        with self._arrived:
            self._error = error
            self._arrived.notify_all()

    def _noted(self, image: Image, timestamp_ns: int | None, last: Arrival | None) -> Arrival:
        came_s = time.monotonic()
        repeated = last is not None and np.array_equal(image, last.image)
        arrival = Arrival(image, 0 if last is None else last.number + 1, came_s, timestamp_ns, repeated)
        with self._arrived:
            if not repeated:
                self._changed_s = came_s
            self.repeated += repeated
            if last is not None:
                self._count_gap(came_s - last.came_s)
            self._frames.append(arrival)
            self._arrived.notify_all()
        return arrival

    def _count_gap(self, interval_s: float) -> None:
        """Count dropped frames. A late frame is followed by a short interval, which cancels; a dropped one is not."""
        if len(self._intervals_s) == _INTERVALS:
            self._late = max(0, self._late + round(interval_s / median(self._intervals_s)) - 1)
        self._intervals_s.append(interval_s)
