"""Pipelined acquisition: the next pictures are on their way to the wall while the camera exposes the present one.

    screen      ▏1       ▏2       ▏3       ▏4
    wall                      ▏1       ▏2       ▏3       ▏4
    camera                     ▐ 1   ▌  ▐ 2   ▌  ▐ 3   ▌  ▐ 4   ▌

An exposure must fit between the latest light of its picture and the earliest light of the next one. Both follow from
the measured times of the swaps. A frame counts if it was triggered in time, if the camera's clock agrees, and if it
passes verification by complementary sums or parity (`redundancy.py`). A missed picture is
shown again behind those on their way. After many misses the next ones are taken at rest, more each time. The period
adapts to the jitter of the last frames (`trigger_schedule.py`). With the pace `AT_REST` all frames are taken at rest:
they are verified and repeated alike, because a window system may show a picture late.
"""

import logging
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress

from calib.numerics import Image
from hw.errors import DeviceError, FrameLostError
from hw.rig import NO_REDUNDANCY, Frames, Redundancy
from hw.timing.devices import ATTEMPTS, BufferedProjector, CameraGroup
from hw.timing.redundancy import ComplementarySums, WithParity, with_parity
from hw.timing.sequential import SequentialAcquisition
from hw.timing.timed_rig import Tally
from hw.timing.trigger_schedule import Pace, TriggerJitter, TriggerSchedule
from hw.timing.verification import FrameVerification, Group, NumberedPictures

log = logging.getLogger(__name__)

_MOST_AT_REST = 32
_MOST_UNFOUNDED = 3  # failed verifications that the scene caused: with blur, flicker or interreflection
_CALM = 16  # successful frames in a row that halve the penalty


class PipelinedAcquisition:
    """Takes frames of pictures at a fixed period; those that fail are repeated by `sequential`."""

    def __init__(
        self,
        projector: BufferedProjector,
        cameras: CameraGroup,
        sequential: SequentialAcquisition,
        rhythm: Pace,
        sums: Sequence[ComplementarySums],
    ) -> None:
        self._projector = projector
        self._cameras = cameras
        self._sequential = sequential
        self.rhythm = rhythm
        self._sums = sums
        self._exposure_s = cameras.exposure_s
        self._schedule = TriggerSchedule(projector, rhythm)
        self._jitter = TriggerJitter(rhythm)
        self.missed = 0
        self.doubted = 0

    @property
    def period_s(self) -> float:
        """The present time between pictures."""
        return self._jitter.period_s

    @property
    def tally(self) -> Tally:
        """Counts and times of the frames."""
        return self._sequential.tally

    @property
    def possible(self) -> bool:
        """Whether the exposure is still the one of the calibration."""
        return self._cameras.exposure_s == self._exposure_s

    def frames(self, images: Iterable[Image], redundancy: Redundancy) -> Iterator[Frames]:
        """Yield the verified frames of each image, in order. Images in no group are taken at rest.

        Raises DeviceError, and whatever `images` raises.
        """
        self.tally.begin()
        self.missed = self.doubted = 0
        taken: dict[int, Frames] = {}
        following = 0
        numbered = with_parity(images, redundancy)
        for number, frames in self._series(numbered):
            taken[number] = frames
            self._verification.note(number, frames)
            if not self._schedule.outstanding:
                self._verification.judge()  # otherwise during the next exposure
            while self._verification.judged:
                for group in [*self._verification.judged]:
                    foreign = self._verification.foreign(group)  # again: neighbouring frames may have been repeated
                    if not self._repeats_pipelined(group, foreign):
                        self._prove(group, foreign, taken)
                        self._verification.settle(group)
                if not self._schedule.outstanding:
                    self._verification.judge()  # groups may wait for each other
            while following in taken and not self._verification.lacks(following):
                proven = taken.pop(following)
                if following not in numbered.added:
                    self.tally.take()
                    yield proven
                following += 1
                self._pictures.forget(following)

    def rehearse(self, images: Iterable[Image]) -> Iterator[Frames]:
        """Frames in order, checked by their timing only: the caller verifies them."""
        return (frame for _, frame in self._series(with_parity(images, NO_REDUNDANCY), proven=False))

    def _series(self, numbered: WithParity, *, proven: bool = True) -> Iterator[tuple[int, Frames]]:
        """Numbers and frames; the caller may repeat others in between, after `_stop_pipelining`. Grouped pictures are
        pipelined. Without verification (`proven` False) all are, and frames come in order.
        """
        self._pictures = NumberedPictures(numbered.images)
        self._verification = FrameVerification(self._sums, self._pictures, numbered.level, numbered.even)
        self._in_order = not proven
        self._resting, self._penalty, self._caught_in_row = 0, 1, 0
        self._rested, self._unfounded, self._doubts = set[int](), 0, set[Group]()
        self._next, self._again = 0, list[int]()  # the first untried picture, and those to repeat
        self._schedule.settle()
        self._schedule = TriggerSchedule(self._projector, self.rhythm)
        try:
            while self._schedule.outstanding or self._again or self._pictures.has(self._next):
                at_rest = [] if self._schedule.outstanding else self._next_at_rest()
                if at_rest:
                    yield from self._at_rest(at_rest)
                    continue
                number, frame = self._catch()
                if frame is None:
                    self._missed(number)
                else:
                    self._lower_penalty()
                    yield number, frame
        finally:
            with suppress(DeviceError):  # another error was raised before
                self._schedule.settle()

    def _next_at_rest(self) -> list[int]:
        """The next pictures to take at rest, up to the first that may be pipelined."""
        again = [*self._again] if self._unverifiable else self._again[: self._resting]
        if len(again) < len(self._again):
            return again
        number = self._next
        while (
            len(again) < _MOST_AT_REST
            and self._pictures.has(number)
            and (len(again) < self._resting or self._unverifiable or not self._may_be_pipelined(number))
        ):
            again.append(number)
            number += 1
        return again

    def _at_rest(self, numbers: Sequence[int]) -> Iterator[tuple[int, Frames]]:
        self._stopped = True
        for number, frame in self._rest(numbers):
            self._rested.add(number)
            self._resting = max(0, self._resting - 1)
            if number in self._again:
                self._again.remove(number)
            self._next = max(self._next, number + 1)
            yield number, frame
            if not self._stopped:
                break  # others were shown meanwhile and replaced the picture on its way

    def _rest(self, numbers: Sequence[int], twice: Collection[int] = ()) -> Iterator[tuple[int, Frames]]:
        """Frames of pictures at rest. Those in `twice` are taken twice and the second counts: by then nothing of the
        previous pictures is on the wall. The first picture also needs this after one of its own group, because equal
        shares of each other cancel in the sum.
        """
        before = self._schedule.beside()
        if self._verification.are_together(numbers[0], before):
            twice = {*twice, numbers[0]}
        row = [number for number in numbers for _ in range(1 + (number in twice))]
        self._verification.set_sequence(row, before)
        pictures = (self._pictures[number] for number in row)
        self._schedule.settle(row[0])
        frames = self._sequential.at_rest(pictures, numbers=row)
        for number, following, frame in zip(row, [*row[1:], None], frames, strict=True):
            self._schedule.settle(*(() if following is None else (following,)))  # swapped by then
            if following == number:
                continue
            if number in twice:
                self._verification.clear_neighbours(number)
            yield number, frame

    def _stop_pipelining(self) -> None:
        """Stop pipelining: let all scheduled pictures be shown, and schedule those that were not exposed again."""
        self._again = sorted({*self._again, *self._schedule.settle()})
        self._stopped = False

    @property
    def _unverifiable(self) -> bool:
        """Whether verification is impossible with this scene."""
        return self._unfounded >= _MOST_UNFOUNDED

    def _is_unverifiable(self, group: Group) -> bool:
        return self._unverifiable and self._rested.issuperset(group)

    def _may_be_pipelined(self, number: int) -> bool:
        return self.rhythm.pipelines and (self._in_order or self._verification.lacks(number))

    def _catch(self) -> tuple[int, Frames | None]:
        """Expose the next picture on its way; returns its number and frames, or None if it was missed or lost."""
        schedule = self._schedule
        if not schedule.outstanding:  # the first picture is shown as soon as it is drawn
            self._schedule_next(most=1)
            schedule.light_s()
        self._schedule_next()
        light_s = schedule.light_s()
        time.sleep(max(0.0, light_s - time.monotonic()))
        latest_s = schedule.latest_begin_s(self._exposure_s)
        beside, begin_s = schedule.beside(), time.monotonic()
        if begin_s > latest_s:
            number = schedule.pass_on()
            log.info("picture %d was missed by %.1f ms", number, 1e3 * (begin_s - latest_s))
            self._jitter.begun(begin_s - light_s)
            return number, None
        number = schedule.pass_on(begin_s)
        self._verification.set_neighbours(number, beside)
        triggered_s = self._cameras.expose(self._while_exposed)
        try:
            frames = self._cameras.collect()
            self._jitter.ready(time.monotonic() - triggered_s)
            begun_s = triggered_s + self._cameras.late_s
            self._jitter.begun(begun_s - light_s)
            if begun_s > latest_s:
                raise FrameLostError(f"{1e3 * (begun_s - latest_s):.1f} ms too late for its picture")
        except FrameLostError as lost:
            log.info("frame %d was lost (%s)", number, str(lost))  # the error itself would keep its frames alive
            self.tally.retriggered += 1
            return number, None
        self._schedule.captured()
        return number, frames

    def _while_exposed(self) -> None:
        """Work done during the exposure."""
        self._schedule_next()
        self._verification.judge()

    def _schedule_next(self, most: int | None = None) -> None:
        """Schedule the pictures that must leave before the next one is exposed, at most `most` of them."""
        period_s = self.period_s
        while (most is None or most > 0) and self._schedule.wants(period_s):
            if self._again:
                number = self._again.pop(0)
            elif self._pictures.has(self._next) and self._may_be_pipelined(self._next):
                number, self._next = self._next, self._next + 1
            else:
                return
            self._schedule.appoint(number, self._pictures[number], period_s)
            most = None if most is None else most - 1

    def _missed(self, number: int) -> None:
        """Schedule a missed picture again. After many misses, or if order matters, stop pipelining for a while."""
        self.missed, self._caught_in_row = self.missed + 1, 0
        self._again = sorted({*self._again, number})
        if self._jitter.fails() or self._in_order:
            self._rest_a_while()
            self._stop_pipelining()

    def _rest_a_while(self) -> None:
        """Take the next frames at rest, twice as many as the last time."""
        self._resting, self._penalty = self._penalty, min(_MOST_AT_REST, 2 * self._penalty)

    def _lower_penalty(self) -> None:
        self._caught_in_row += 1
        self._jitter.holds()
        if self._caught_in_row % _CALM == 0:
            self._penalty = max(1, self._penalty // 2)

    def _repeats_pipelined(self, group: Group, foreign: float) -> bool:
        """Whether to repeat a group with foreign light pipelined, because a single late picture does not need rest.

        Not if several groups failed, nor for parity groups or groups that were partly taken at rest.
        """
        if foreign <= 1 or group in self._doubts or self._is_unverifiable(group):
            return False
        log.info("frames %s: foreign by %.1f times the tolerance", group, foreign)
        several = self._unfounded > 0 or any(self._verification.lacks(doubt[0]) for doubt in self._doubts)
        self._doubts.add(group)
        self.doubted += len(self._verification.suspects(group))
        self.missed, self._caught_in_row = self.missed + 1, 0
        if several or self._verification.is_even(group) or not self._rested.isdisjoint(group):
            return False
        self.tally.retriggered += len(group)
        self._again = sorted({*self._again, *group})
        self._verification.reopen(group)
        return True

    def _prove(self, group: Group, foreign: float, taken: dict[int, Frames]) -> None:
        """Repeat the frames of a group at rest until they pass; `foreign`: what their verification says so far.

        Frames at rest can be wrong, too. If repeated frames look the same, the scene is the cause.
        """
        if self._is_unverifiable(group):
            return
        verification, last = self._verification, None
        for attempt in range(ATTEMPTS):
            if foreign <= 1:
                return
            suspects = verification.suspects(group)
            if last is None:
                self._rest_a_while()
            elif verification.is_unchanged(last) and last.neighbours.keys() >= {*suspects}:
                break
            self.tally.retriggered += len(suspects)
            last = verification.snapshot(suspects)
            self._stop_pipelining()
            # Reverse the order: the same late picture would otherwise leave the same trace.
            order = suspects if attempt % 2 else suspects[::-1]
            for number, frames in self._rest(order, twice=order if attempt or verification.is_even(group) else ()):
                taken[number] = frames
                verification.note(number, frames)
            foreign = verification.foreign(group)
            log.info("frames %s, at rest: foreign by %.1f times the tolerance", group, foreign)
        self._unfounded += 1
