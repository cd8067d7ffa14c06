"""When each picture leaves for the wall, how it is known that it did, and which pictures are there before and after it.

Pictures leave one after the other, each in a slot of its own; a picture that was missed may have another one later.
"""

import time
from dataclasses import dataclass
from math import ceil

from calib.numerics import Image
from hw.timing.devices import BufferedProjector, Swap, TriggeredCamera
from hw.timing.latency import Latency

_STILL_THERE = 2
SLACK_S = 0.002  # what trigger and swap may be late without a picture being missed, as long as nobody knows better
# Of the margin before the next picture's light: a frame that ends in it is right if the picture proves it, and costs
# less than one that is taken again.
_GRACE_S = 0.0007
HEADWAY_S = 0.0005  # pictures follow each other so much slower than frames: what one is late, the next ones make up for


@dataclass(frozen=True)
class Pace:
    """Light comes `soonest_s` after the begin of a swap, or later, and is all there `latest_s` after its end, margins
    included; swaps take `swapping_s`. Pictures are `least_s` apart at least, lest the light of two falls into one
    exposure, even if the camera is told in time and then begins `wait_s` later, and `cycle_s`, for the camera to be
    ready again.
    """

    soonest_s: float
    latest_s: float
    swapping_s: float
    least_s: float
    cycle_s: float
    wait_s: float

    @property
    def period_s(self) -> float:
        """How far apart pictures are, as long as no frame has told more."""
        return max(self.least_s + SLACK_S, self.cycle_s + HEADWAY_S)

    @property
    def outstanding(self) -> int:
        """How many pictures are on their way to the wall at most."""
        return ceil(self.lead_s / self.period_s)

    @property
    def lead_s(self) -> float:
        """From when a picture leaves until it may be exposed."""
        return self.latest_s + self.swapping_s


def pace(measured: Latency, camera: TriggeredCamera, margin_s: float) -> Pace:
    """The shortest period for light that comes so soon, and so late, with a margin for either.

    In the light of every picture there is time for a whole exposure, whenever the camera begins.
    """
    soonest_s, latest_s = measured.soonest_s - margin_s, measured.latest_s + margin_s
    uncertain_s = max(0.0, latest_s + measured.swapping_s - soonest_s)
    wait_s = camera.wait_s
    least_s = camera.exposure_s + uncertain_s + wait_s
    return Pace(soonest_s, latest_s, measured.swapping_s, least_s, measured.cycle_s + wait_s, wait_s)


class TriggerSchedule:
    """Slots of pictures, which have numbers; `slot` is the one whose picture is to be exposed next."""

    def __init__(self, projector: BufferedProjector, rhythm: Pace) -> None:
        self._projector = projector
        self._rhythm = rhythm
        self._order: dict[int, int] = {}  # the picture in each slot
        self._planned: dict[int, float] = {}  # slots that have not been kept so far, and when they are due
        self._swaps: dict[int, Swap] = {}
        self._flip_s = 0.0
        self._end = 0  # the first slot that nobody has
        self._before: list[int] = []  # what may be on the wall: from the last picture on of which there is a frame
        self._reference: tuple[int, float] | None = None  # a slot, and when the camera was ready for it
        self.slot = 0

    @property
    def outstanding(self) -> list[int]:
        """The pictures that are to be exposed, in the order of their slots."""
        return [self._order[slot] for slot in range(self.slot, self._end)]

    def wants(self, period_s: float) -> bool:
        """Whether one more has to be appointed before the next picture is exposed."""
        return self._end - self.slot <= ceil(self._rhythm.lead_s / period_s) + 1

    def appoint(self, number: int, image: Image, period_s: float) -> None:
        """Give a picture the next slot, so long after the one before it, or later if it cannot be kept any more."""
        when_s = max(self._flip_s + period_s, time.monotonic())
        if self._reference is not None:
            known, begin_s = self._reference
            when_s = max(when_s, begin_s + (self._end - known) * period_s - self._rhythm.lead_s)
        self._projector.show_at(image, when_s)
        self._planned[self._end] = self._flip_s = when_s
        self._order[self._end] = number
        self._end += 1

    def light_s(self) -> float:
        """When the light of the next picture is all there; waits until the picture has left."""
        while self.slot not in self._swaps:
            self._hear(wait=True)
        return self._swaps[self.slot].done_s + self._rhythm.latest_s

    def latest_begin_s(self, exposure_s: float) -> float:
        """When an exposure has to have begun, lest it sees the next picture."""
        while self._planned and self._hear(wait=False):
            pass
        after = self.slot + 1
        if after in self._swaps:
            next_s = self._swaps[after].begun_s
        elif after in self._planned:
            next_s = self._planned[after]  # it does not leave sooner
        else:
            return float("inf")
        return next_s + self._rhythm.soonest_s + _GRACE_S - exposure_s

    def beside(self) -> list[int]:
        """The pictures whose light may be in the next one's frame: before it and, if it is on its way, after it."""
        return [*self._before, *([self._order[self.slot + 1]] if self.slot + 1 in self._order else ())]

    def pass_on(self, begin_s: float | None = None) -> int:
        """Go on to the next slot; returns the picture in this one. `begin_s`: when its exposure began, if it did."""
        if begin_s is not None:
            self._reference = self.slot, begin_s
        number = self._order.pop(self.slot)
        self._before.append(number)
        self._swaps.pop(self.slot, None)
        self.slot += 1
        return number

    def seen(self) -> None:
        """There is a frame of the picture that was passed on last: it was there, and none of those before is."""
        self._before = self._before[-1:]

    def settle(self, *shown: int) -> list[int]:
        """Let everything that is on its way be shown; returns what was to be exposed, which has no slots any more.

        `shown`: pictures that have left since, otherwise than by this schedule. Between those and the next there may be
        less than a period, so that the last but one may still be on the wall.
        """
        while self._planned:
            self._hear(wait=True)
        left = self.outstanding
        self._before = [*self._before, *left, *shown][-_STILL_THERE:]
        self._swaps.clear()
        self._order.clear()
        self.slot = self._end
        self._reference = None
        return left

    def _hear(self, *, wait: bool) -> bool:
        swap = self._projector.shown(wait=wait)
        if swap is None:
            return False
        slot = min(self._planned)
        del self._planned[slot]
        self._swaps[slot] = swap
        self._flip_s = max(self._flip_s, swap.done_s - self._rhythm.swapping_s)
        return True
