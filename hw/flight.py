"""Pictures in flight: the next ones are on their way to the wall while the camera exposes the one that is there.

    screen      ▏1       ▏2       ▏3       ▏4
    wall                      ▏1       ▏2       ▏3       ▏4
    camera                     ▐ 1   ▌  ▐ 2   ▌  ▐ 3   ▌  ▐ 4   ▌

An exposure fits between the light of its picture, as late as that can be, and the light of the next one, as soon as
that can be. When that is follows from when the pictures were swapped in, which the process that did it tells. A frame
counts if it was triggered in time, if the camera's clock agrees, and if its picture and its neighbours' light every
place alike together (`hw/level_sums.py`). Any other is taken again of a picture at rest, and for a while so are those
that follow: how long, and how much time there is between pictures, depends on how often that happens.
"""

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count, takewhile
from math import ceil

from calib.numerics import Floats, Image
from hw.errors import DeviceError, FrameLostError
from hw.flashes import Latency
from hw.level_sums import LevelSums
from hw.rig import Frame
from hw.timed_devices import ATTEMPTS, BufferedProjector, Swap, TriggeredCamera
from hw.turns import Tally, Turns

log = logging.getLogger(__name__)

_SLACK_S = 0.002  # what trigger and swap may be late without a picture being missed
_CYCLE_FADES = 0.9  # of one frame to the next: the time that the slowest took lately
_MOST_AT_REST = 32
_MOST_EXTRA_S, _EXTRA_FADES = 0.02, 0.95  # after misses, and with every frame that is caught
_MOST_UNFOUNDED = 3  # doubts that were the scene's own: with blur, flicker, or bounced light sums are never level
_CALM = 16  # so many frames in a row that were caught make up for a missed one


@dataclass(frozen=True)
class Pace:
    """Light comes `soonest_s` after the begin of a swap, or later, and is all there `latest_s` after its end, margins
    included; swaps take `swapping_s`. `period_s`: how far apart pictures are at least.
    """

    soonest_s: float
    latest_s: float
    swapping_s: float
    period_s: float

    @property
    def in_flight(self) -> int:
        """How many pictures are on their way to the wall at most."""
        return ceil((self.latest_s + self.swapping_s) / self.period_s)


def pace(measured: Latency, camera: TriggeredCamera, margin_s: float) -> Pace:
    """The shortest period for light that comes so soon, and so late, with a margin for either.

    In the light of every picture there is time for a whole exposure, whenever the camera begins.
    """
    soonest_s, latest_s = measured.soonest_s - margin_s, measured.latest_s + margin_s
    uncertain_s = max(0.0, latest_s + measured.swapping_s - soonest_s)
    period_s = max(camera.exposure_s + uncertain_s, measured.cycle_s) + camera.wait_s + _SLACK_S
    return Pace(soonest_s, latest_s, measured.swapping_s, period_s)


class Flight:
    """Frames of pictures that follow each other at a pace; those that fail are taken by `turns`."""

    def __init__(
        self, projector: BufferedProjector, camera: TriggeredCamera, turns: Turns, rhythm: Pace, sums: LevelSums
    ) -> None:
        self._projector = projector
        self._camera = camera
        self._turns = turns
        self.rhythm = rhythm
        self._sums = sums
        self._exposure_s = camera.exposure_s
        self._planned: dict[int, float] = {}  # appointments that have not been kept so far
        self._swaps: dict[int, Swap] = {}
        self._flip_s = 0.0
        self._extra_s = 0.0  # slack that misses have asked for
        self._cycle_s = 0.0  # from a trigger to the next, as far as the camera goes
        self._reference: tuple[int, float] | None = None  # a picture, and when the camera was ready for it
        self.missed = 0
        self.doubted = 0

    @property
    def tally(self) -> Tally:
        """What the frames cost."""
        return self._turns.tally

    @property
    def possible(self) -> bool:
        """Whether the camera still exposes for as long as the pace was measured for."""
        return self._camera.exposure_s == self._exposure_s

    def frames(self, images: Iterable[Image], level: Sequence[Sequence[int]]) -> Iterator[Frame]:
        """A frame of each image, when it is proven. `level`: the numbers of images that light every place alike
        together; images that are in none of these are taken at rest.

        Raises DeviceError, and whatever `images` raises.
        """
        self.tally.begin()
        self.missed = self.doubted = 0
        self._seen: dict[int, Floats] = {}
        taken: dict[int, Frame] = {}
        unproven = {number: group for group in level for number in group}
        following = 0
        for number, frame in self._series(images, level):
            taken[number], self._seen[number] = frame, self._sums.seen(frame.image)
            for group in dict.fromkeys(map(tuple, unproven.values())):
                last = max(group)  # the frame after it, if there is one, may have to do with it
                if number > last or (number == last and not self._pictures.has(number + 1)):
                    self._prove(group, taken, number)
                    unproven = {each: of for each, of in unproven.items() if each not in group}
            while following in taken and following not in unproven:
                self.tally.take()
                yield taken.pop(following)
                following += 1
                self._pictures.forget(following)

    def rehearse(self, images: Iterable[Image]) -> Iterator[Frame]:
        """The same without any proof but that of time: somebody else looks at the frames."""
        return (frame for _, frame in self._series(images, None))

    def _series(self, images: Iterable[Image], level: Sequence[Sequence[int]] | None) -> Iterator[tuple[int, Frame]]:
        """Frames and numbers; between them, others may be taken again after `_settle`. Without `level`, all fly."""
        self._pictures = _Pictures(iter(images))
        self._flying = None if level is None else {number for group in level for number in group}
        self._resting, self._penalty, self._caught_in_row = 0, 1, 0
        self._rested, self._unfounded = set[int](), 0
        self._settle(0)
        number = 0
        try:
            while self._pictures.has(number):
                stop = self._rests_until(number)
                if stop > number:
                    for found in self._at_rest(number, stop):
                        yield found
                        number = found[0] + 1
                    self._settle(number)
                elif caught := self._catch(number):
                    self._calm_down()
                    yield number, caught
                    number += 1
                else:
                    self._slow_down()
                    self._settle(number)
        finally:
            with suppress(DeviceError):  # it is not the first then
                self._settle(0)

    def _at_rest(self, first: int, stop: int) -> Iterator[tuple[int, Frame]]:
        self._settle(first)
        pictures = (self._pictures[k] for k in takewhile(self._pictures.has, range(first, stop)))
        for number, frame in enumerate(self._turns.at_rest(pictures, numbers=count(first)), first):
            self._rested.add(number)
            self._resting = max(0, self._resting - 1)
            self._interrupted = False
            yield number, frame
            if self._interrupted:
                break  # the picture that was on its way is not there any more

    def _rests_until(self, number: int) -> int:
        """The first picture from there on that may fly."""
        stop = number + self._resting
        while self._pictures.has(stop) and (self._grounded or not self._may_fly(stop)):
            stop += 1
        return stop

    @property
    def _grounded(self) -> bool:
        """Whether the scene is such that sums prove nothing."""
        return self._unfounded >= _MOST_UNFOUNDED

    def _may_fly(self, number: int) -> bool:
        return self._flying is None or number in self._flying

    def _catch(self, number: int) -> Frame | None:
        """A frame of a picture on its way; None if its time was missed, or the frame lost."""
        if self._reference is None:  # the first picture leaves when it is drawn, the others so much later
            self._commit(number, number)
            self._swap(number)
        self._commit(number)
        light_s = self._swap(number).done_s + self.rhythm.latest_s
        time.sleep(max(0.0, light_s - time.monotonic()))
        latest_s = self._latest_begin_s(number)
        begin_s = time.monotonic()
        if begin_s > latest_s:
            log.info("picture %d was missed by %.1f ms", number, 1e3 * (begin_s - latest_s))
            return None
        triggered_s = self._camera.expose()
        try:
            frame = self._camera.collect()
            late_s = triggered_s + self._camera.late_s - latest_s
            if late_s > 0:
                raise FrameLostError(f"{1e3 * late_s:.1f} ms too late for its picture")
        except FrameLostError as lost:
            log.info("frame %d was lost in flight (%s)", number, lost)
            self.tally.retriggered += 1
            return None
        self._cycle_s = max(time.monotonic() - begin_s, _CYCLE_FADES * self._cycle_s)
        self._reference = number, begin_s
        return frame

    def _commit(self, number: int, last: int | None = None) -> None:
        """Appoint the pictures that have to leave before the one after this is exposed, or up to the `last`."""
        period_s = max(self.rhythm.period_s, self._cycle_s + _SLACK_S / 2) + self._extra_s
        lead_s = self.rhythm.latest_s + self.rhythm.swapping_s
        last = number + ceil(lead_s / period_s) + 1 if last is None else last
        while self._committed <= last and self._pictures.has(self._committed) and self._may_fly(self._committed):
            when_s = max(self._flip_s + period_s, time.monotonic())
            if self._reference is not None:
                known, begin_s = self._reference
                when_s = max(when_s, begin_s + (self._committed - known) * period_s - lead_s)
            self._projector.show_at(self._pictures[self._committed], when_s)
            self._planned[self._committed] = self._flip_s = when_s
            self._committed += 1

    def _swap(self, number: int) -> Swap:
        """That of a picture, which is waited for."""
        while number not in self._swaps:
            self._hear(wait=True)
        return self._swaps[number]

    def _hear(self, *, wait: bool) -> bool:
        swap = self._projector.shown(wait=wait)
        if swap is None:
            return False
        number = min(self._planned)
        del self._planned[number]
        self._swaps[number] = swap
        self._flip_s = max(self._flip_s, swap.done_s - self.rhythm.swapping_s)
        return True

    def _latest_begin_s(self, number: int) -> float:
        """When an exposure has to have begun, lest it sees the next picture."""
        while self._planned and self._hear(wait=False):
            pass
        if number + 1 in self._swaps:
            next_s = self._swaps[number + 1].begun_s
        elif number + 1 in self._planned:
            next_s = self._planned[number + 1]  # it does not leave sooner
        else:
            return float("inf")
        return next_s + self.rhythm.soonest_s - self._exposure_s

    def _settle(self, number: int) -> None:
        """Let everything that is on its way be shown; the next to be appointed is that picture."""
        while self._planned:
            self._hear(wait=True)
        self._swaps.clear()
        self._committed = number
        self._reference = None
        self._interrupted = True

    def _slow_down(self) -> None:
        """After a miss: some frames at rest, twice as many as after the last one."""
        self.missed += 1
        self._extra_s = min(_MOST_EXTRA_S, 2 * self._extra_s + _SLACK_S)
        self._resting, self._penalty = self._penalty, min(_MOST_AT_REST, 2 * self._penalty)
        self._caught_in_row = 0

    def _calm_down(self) -> None:
        self._caught_in_row += 1
        self._extra_s *= _EXTRA_FADES
        if self._caught_in_row == _CALM:
            self._penalty, self._caught_in_row = max(1, self._penalty // 2), 0

    def _prove(self, group: Sequence[int], taken: dict[int, Frame], newest: int) -> None:
        """See to it that the frames of a group are its pictures'.

        Frames at rest can be wrong, too; and what twice looks the same is the scene's.
        """
        if self._grounded and self._rested.issuperset(group):
            return
        pictures = [self._pictures[number] for number in group]
        earlier: float | None = None
        for _ in range(ATTEMPTS):
            foreign = self._sums.foreign_share(group, pictures, self._seen)
            tolerance = self._sums.tolerance
            if foreign <= tolerance:
                return
            log.info("frames %s: %.1f %% are foreign", group, 100 * foreign)
            if earlier is not None and abs(foreign - earlier) <= tolerance / 2:
                self._unfounded += 1
                return
            if earlier is None:
                self.doubted += len(group)
                self._slow_down()
            self.tally.retriggered += len(group)
            earlier = foreign
            self._settle(newest + 1)
            for number, frame in zip(group, self._turns.at_rest(pictures, numbers=group), strict=True):
                taken[number], self._seen[number] = frame, self._sums.seen(frame.image)


class _Pictures:
    """Pictures by their numbers, read from an iterator as they are wanted, kept until they are forgotten."""

    def __init__(self, images: Iterator[Image]) -> None:
        self._images = images
        self._known: dict[int, Image] = {}
        self._count = 0
        self._ended = False

    def __getitem__(self, number: int) -> Image:
        return self._known[number]

    def has(self, number: int) -> bool:
        """Whether there is such a picture."""
        while self._count <= number and not self._ended:
            image = next(self._images, None)
            if image is None:
                self._ended = True
            else:
                self._known[self._count] = image
                self._count += 1
        return number < self._count

    def forget(self, before: int) -> None:
        """Pictures with smaller numbers are not wanted any more."""
        for number in [known for known in self._known if known < before]:
            del self._known[number]
