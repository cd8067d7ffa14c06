"""Schedules pictures in slots, records their swaps, and knows which pictures are on the wall before and after each.

A missed picture may get another slot later. The period between slots adapts to the jitter of the last frames.
"""

import time
from collections import deque
from dataclasses import dataclass
from math import ceil, inf, isfinite

from calib.numerics import Image
from hw.timing.devices import BufferedProjector, CameraGroup, Swap
from hw.timing.latency import Latency

_STILL_THERE = 2
SLACK_S = 0.002  # initial allowance for late triggers and swaps
# An exposure may end this far within the margin before the next picture's light: verification finds wrong frames, and
# repeating every such frame would cost more.
_GRACE_S = 0.0007
HEADWAY_S = 0.0005  # pictures follow each other this much more slowly than frames, so that the camera catches up


@dataclass(frozen=True)
class Pace:
    """Timing of pipelined acquisition, margins included."""

    soonest_s: float
    """Light arrives no sooner than this after the begin of a swap."""
    latest_s: float
    """Light has arrived completely this long after the end of a swap."""
    swapping_s: float
    """How long swaps take."""
    least_s: float
    """Pictures are at least this far apart, so that no exposure contains two, even if the camera begins `wait_s` after
    its trigger.
    """
    cycle_s: float
    """Until the camera is ready again."""
    wait_s: float

    @property
    def pipelines(self) -> bool:
        """Whether pictures may follow each other before their frames are taken."""
        return isfinite(self.least_s)

    @property
    def period_s(self) -> float:
        """Initial time between pictures."""
        return max(self.least_s + SLACK_S, self.cycle_s + HEADWAY_S)

    @property
    def outstanding(self) -> int:
        """The largest number of pictures on their way to the wall."""
        return ceil(self.lead_s / self.period_s)

    @property
    def lead_s(self) -> float:
        """Time from the begin of a swap until its picture may be exposed."""
        return self.latest_s + self.swapping_s


# Every frame is taken at rest.
AT_REST = Pace(soonest_s=0.0, latest_s=inf, swapping_s=0.0, least_s=inf, cycle_s=inf, wait_s=inf)


def pace(measured: Latency, cameras: CameraGroup, margin_s: float) -> Pace:
    """The shortest pace for a measured latency, with a margin on either side.

    The light of every picture lasts for a whole exposure, whenever the camera begins.
    """
    soonest_s, latest_s = measured.soonest_s - margin_s, measured.latest_s + margin_s
    uncertain_s = max(0.0, latest_s + measured.swapping_s - soonest_s)
    wait_s = cameras.wait_s
    least_s = cameras.exposure_s + uncertain_s + wait_s
    return Pace(soonest_s, latest_s, measured.swapping_s, least_s, measured.cycle_s + wait_s, wait_s)


class TriggerSchedule:
    """Assigns numbered pictures to slots; `slot` is the one to be exposed next."""

    def __init__(self, projector: BufferedProjector, rhythm: Pace) -> None:
        self._projector = projector
        self._rhythm = rhythm
        self._order: dict[int, int] = {}  # the picture in each slot
        self._planned: dict[int, float] = {}  # slots whose swap has not happened yet, and their times
        self._swaps: dict[int, Swap] = {}
        self._flip_s = 0.0
        self._end = 0  # the first free slot
        self._before: list[int] = []  # pictures that may be on the wall, from the last captured one on
        self._reference: tuple[int, float] | None = None  # a slot, and when the camera was ready for it
        self.slot = 0

    @property
    def outstanding(self) -> list[int]:
        """The pictures to be exposed, in the order of their slots."""
        return [self._order[slot] for slot in range(self.slot, self._end)]

    def wants(self, period_s: float) -> bool:
        """Whether another picture must be scheduled before the next one is exposed."""
        return self._end - self.slot <= ceil(self._rhythm.lead_s / period_s) + 1

    def appoint(self, number: int, image: Image, period_s: float) -> None:
        """Assign the next slot to a picture, `period_s` after the previous one, or as soon as still possible."""
        when_s = max(self._flip_s + period_s, time.monotonic())
        if self._reference is not None:
            known, begin_s = self._reference
            when_s = max(when_s, begin_s + (self._end - known) * period_s - self._rhythm.lead_s)
        self._projector.show_at(image, when_s)
        self._planned[self._end] = self._flip_s = when_s
        self._order[self._end] = number
        self._end += 1

    def light_s(self) -> float:
        """When the light of the next picture is complete; waits for its swap."""
        while self.slot not in self._swaps:
            self._hear(wait=True)
        return self._swaps[self.slot].done_s + self._rhythm.latest_s

    def latest_begin_s(self, exposure_s: float) -> float:
        """The latest begin of an exposure that does not contain the next picture."""
        while self._planned and self._hear(wait=False):
            pass
        after = self.slot + 1
        if after in self._swaps:
            next_s = self._swaps[after].begun_s
        elif after in self._planned:
            next_s = self._planned[after]  # the earliest possible swap
        else:
            return float("inf")
        return next_s + self._rhythm.soonest_s + _GRACE_S - exposure_s

    def beside(self) -> list[int]:
        """The pictures whose light may be in the next frame: those before it, and the one after it if scheduled."""
        return [*self._before, *([self._order[self.slot + 1]] if self.slot + 1 in self._order else ())]

    def pass_on(self, begin_s: float | None = None) -> int:
        """Advance to the next slot; returns this one's picture. `begin_s`: when its exposure began; None if missed."""
        if begin_s is not None:
            self._reference = self.slot, begin_s
        number = self._order.pop(self.slot)
        self._before.append(number)
        self._swaps.pop(self.slot, None)
        self.slot += 1
        return number

    def captured(self) -> None:
        """The last picture was captured, so none before it is on the wall any more."""
        self._before = self._before[-1:]

    def settle(self, *numbers: int) -> list[int]:
        """Wait for all scheduled swaps; returns the pictures that were not exposed, and clears their slots.

        `shown`: pictures shown since, outside this schedule. They may follow each other within less than a period, so
        that the last but one may still be on the wall.
        """
        while self._planned:
            self._hear(wait=True)
        outstanding = self.outstanding
        self._before = [*self._before, *outstanding, *numbers][-_STILL_THERE:]
        self._swaps.clear()
        self._order.clear()
        self.slot = self._end
        self._reference = None
        return outstanding

    def _hear(self, *, wait: bool) -> bool:
        swap = self._projector.shown(wait=wait)
        if swap is None:
            return False
        slot = min(self._planned)
        del self._planned[slot]
        self._swaps[slot] = swap
        self._flip_s = max(self._flip_s, swap.done_s - self._rhythm.swapping_s)
        return True


_LATELY = 16  # frames
_SINGLE = 1  # latest frames that are ignored: a single delay costs that frame, but does not slow down the others
_HEADROOM_S = 0.0008  # beyond the delays of the last frames
_MOST_SLACK_S = 0.02
_USUALLY = 0.75  # quantile of the camera's cycle; slack absorbs longer ones
_FEW, _MANY = 8, 3  # 3 misses within 8 frames are too many


class TriggerJitter:
    """Records for every frame the delay of its exposure, and the time until the camera was ready again."""

    def __init__(self, rhythm: Pace) -> None:
        self._rhythm = rhythm
        self._late_s = deque([SLACK_S - _HEADROOM_S] * (_SINGLE + 1), _LATELY)
        self._cycles_s = deque([rhythm.cycle_s], _LATELY)
        self._missed = deque[bool](maxlen=_FEW)

    @property
    def period_s(self) -> float:
        """Time between pictures: sufficient for all but the latest of the last exposures, and for the camera."""
        slack_s = min(_MOST_SLACK_S, sorted(self._late_s)[-1 - _SINGLE] + _HEADROOM_S)
        usual_s = sorted(self._cycles_s)[int(_USUALLY * len(self._cycles_s))]
        return max(self._rhythm.least_s + slack_s, usual_s + HEADWAY_S)

    def begun(self, late_s: float) -> None:
        """An exposure began, or would have begun, `late_s` after all light of its picture was expected."""
        self._late_s.append(max(0.0, late_s - self._rhythm.wait_s))

    def ready(self, cycle_s: float) -> None:
        """A frame arrived `cycle_s` after its trigger."""
        self._cycles_s.append(cycle_s + self._rhythm.wait_s)

    def holds(self) -> None:
        """A picture was captured."""
        self._missed.append(False)

    def fails(self) -> bool:
        """A picture was missed; returns whether too many were missed lately, and then restarts the count."""
        self._missed.append(True)
        many = self._missed.count(True) >= _MANY
        if many:
            self._missed.clear()
        return many
