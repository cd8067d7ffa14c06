"""Pipelined acquisition: the next pictures are on their way to the wall while the camera exposes the one that is there.

    screen      ▏1       ▏2       ▏3       ▏4
    wall                      ▏1       ▏2       ▏3       ▏4
    camera                     ▐ 1   ▌  ▐ 2   ▌  ▐ 3   ▌  ▐ 4   ▌

An exposure fits between the light of its picture, as late as that can be, and the light of the next one, as soon as
that can be. When that is follows from when the pictures were swapped in, which the process that did it tells. A frame
counts if it was triggered in time, if the camera's clock agrees, and if its picture and others light every place alike
together (`complementary_sums.py`) or, bits without inverses, an even number of times (`parity_check.py`). A picture
that was missed is shown again, behind those that are on their way; where many are, those that follow are taken at rest
for a while, longer each time. How much time there is between pictures, the last frames tell (`jitter.py`).
"""

import logging
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress

from calib.numerics import Image
from hw.errors import DeviceError, FrameLostError
from hw.rig import Frame
from hw.timing.complementary_sums import ComplementarySums
from hw.timing.devices import ATTEMPTS, BufferedProjector, TriggeredCamera
from hw.timing.jitter import TriggerJitter
from hw.timing.numbered_pictures import NumberedPictures
from hw.timing.parity_check import WithParity, with_parity
from hw.timing.sequential import SequentialAcquisition
from hw.timing.timed_rig import Tally
from hw.timing.trigger_schedule import Pace, TriggerSchedule
from hw.timing.verification import FrameVerification, Group

log = logging.getLogger(__name__)

_MOST_AT_REST = 32
_MOST_UNFOUNDED = 3  # doubts that were the scene's own: with blur, flicker, or bounced light sums are never level
_CALM = 16  # so many frames in a row that were caught make up for a missed one


class PipelinedAcquisition:
    """Frames of pictures that follow each other at a pace; those that fail are taken by `sequential`."""

    def __init__(
        self,
        projector: BufferedProjector,
        camera: TriggeredCamera,
        sequential: SequentialAcquisition,
        rhythm: Pace,
        sums: ComplementarySums,
    ) -> None:
        self._projector = projector
        self._camera = camera
        self._sequential = sequential
        self.rhythm = rhythm
        self._sums = sums
        self._exposure_s = camera.exposure_s
        self._schedule = TriggerSchedule(projector, rhythm)
        self._jitter = TriggerJitter(rhythm)
        self.missed = 0
        self.doubted = 0

    @property
    def period_s(self) -> float:
        """From one picture to the next, by now."""
        return self._jitter.period_s

    @property
    def tally(self) -> Tally:
        """What the frames cost."""
        return self._sequential.tally

    @property
    def possible(self) -> bool:
        """Whether the camera still exposes for as long as the pace was measured for."""
        return self._camera.exposure_s == self._exposure_s

    def frames(
        self, images: Iterable[Image], level: Sequence[Sequence[int]], unpaired: Sequence[Sequence[int]] = ()
    ) -> Iterator[Frame]:
        """A frame of each image, when it is proven. `level`: the numbers of images that light every place alike
        together; `unpaired`: of images of black and white that one more picture is to prove. Images that are in none of
        these are taken at rest.

        Raises DeviceError, and whatever `images` raises.
        """
        self.tally.begin()
        self.missed = self.doubted = 0
        taken: dict[int, Frame] = {}
        following = 0
        shown = with_parity(images, level, unpaired)
        for number, frame in self._series(shown):
            taken[number] = frame
            self._verification.note(number, frame.image)
            if not self._schedule.outstanding:
                self._verification.judge()  # else while the next picture is exposed, when it costs no time
            while self._verification.judged:
                for group in [*self._verification.judged]:
                    foreign = self._verification.foreign_share(
                        group
                    )  # by now: frames beside it may have been taken again
                    if not self._flies_again(group, foreign):
                        self._prove(group, foreign, taken)
                        self._verification.settle(group)
                if not self._schedule.outstanding:
                    self._verification.judge()  # one may have waited for another
            while following in taken and not self._verification.lacks(following):
                proven = taken.pop(following)
                if following not in shown.added:
                    self.tally.take()
                    yield proven
                following += 1
                self._pictures.forget(following)

    def rehearse(self, images: Iterable[Image]) -> Iterator[Frame]:
        """The same without any verification but that of time: somebody else looks at the frames, in their order."""
        return (frame for _, frame in self._series(with_parity(images, (), ()), proven=False))

    def _series(self, shown: WithParity, *, proven: bool = True) -> Iterator[tuple[int, Frame]]:
        """Frames and numbers; between them, others may be taken again after `_land`. What is in a group may fly; if
        nothing is to be proven all may, and frames come in the order of their pictures.
        """
        self._pictures = NumberedPictures(shown.images)
        self._verification = FrameVerification(self._sums, self._pictures, shown.level, shown.even)
        self._in_order = not proven
        self._resting, self._penalty, self._caught_in_row = 0, 1, 0
        self._rested, self._unfounded, self._doubts = set[int](), 0, set[Group]()
        self._next, self._again = 0, list[int]()  # the first that was not tried, and those that are to be tried again
        self._schedule.settle()
        self._schedule = TriggerSchedule(self._projector, self.rhythm)
        try:
            while self._schedule.outstanding or self._again or self._pictures.has(self._next):
                at_rest = [] if self._schedule.outstanding else self._that_rest()
                if at_rest:
                    yield from self._at_rest(at_rest)
                    continue
                number, frame = self._catch()
                if frame is None:
                    self._missed(number)
                else:
                    self._calm_down()
                    yield number, frame
        finally:
            with suppress(DeviceError):  # it is not the first then
                self._schedule.settle()

    def _that_rest(self) -> list[int]:
        """The next pictures, up to the first that may fly."""
        found = [*self._again] if self._grounded else self._again[: self._resting]
        if len(found) < len(self._again):
            return found
        number = self._next
        while self._pictures.has(number) and (
            len(found) < self._resting or self._grounded or not self._may_fly(number)
        ):
            found.append(number)
            number += 1
        return found

    def _at_rest(self, numbers: Sequence[int]) -> Iterator[tuple[int, Frame]]:
        self._landed = True
        for number, frame in self._rest(numbers):
            self._rested.add(number)
            self._resting = max(0, self._resting - 1)
            if number in self._again:
                self._again.remove(number)
            self._next = max(self._next, number + 1)
            yield number, frame
            if not self._landed:
                break  # others were shown meanwhile, and the picture that was on its way is not there any more

    def _rest(self, numbers: Sequence[int], twice: Collection[int] = ()) -> Iterator[tuple[int, Frame]]:
        """Frames of pictures at rest; of some the second that is taken: so long after its picture has left, nothing of
        those before is on the wall. That is asked for of `twice`, and needed by a picture that others of its own group
        were on the wall before: where one has as much of the other as the other of it, no sum tells.
        """
        before = self._schedule.beside()
        if self._verification.are_together(numbers[0], before):
            twice = {*twice, numbers[0]}
        row = [number for number in numbers for _ in range(1 + (number in twice))]
        self._verification.stood_in_row(row, before)
        pictures = (self._pictures[number] for number in row)
        self._schedule.settle(row[0])
        frames = self._sequential.at_rest(pictures, numbers=row)
        for number, following, frame in zip(row, [*row[1:], None], frames, strict=True):
            self._schedule.settle(*(() if following is None else (following,)))  # it has left when a frame is there
            if following == number:
                continue
            if number in twice:
                self._verification.stood_alone(number)
            yield number, frame

    def _land(self) -> None:
        """Let everything that is on its way be shown, for something else is to be; what was not exposed flies again."""
        self._again = sorted({*self._again, *self._schedule.settle()})
        self._landed = False

    @property
    def _grounded(self) -> bool:
        """Whether the scene is such that sums prove nothing."""
        return self._unfounded >= _MOST_UNFOUNDED

    def _is_grounded(self, group: Group) -> bool:
        return self._grounded and self._rested.issuperset(group)

    def _may_fly(self, number: int) -> bool:
        return self._in_order or self._verification.lacks(number)

    def _catch(self) -> tuple[int, Frame | None]:
        """The next picture on its way, and a frame of it; None if its time was missed, or the frame lost."""
        schedule = self._schedule
        if not schedule.outstanding:  # the first picture leaves when it is drawn, the others so much later
            self._appoint(most=1)
            schedule.light_s()
        self._appoint()
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
        self._verification.stood_beside(number, beside)
        triggered_s = self._camera.expose(self._while_exposed)
        try:
            frame = self._camera.collect()
            self._jitter.ready(time.monotonic() - triggered_s)
            begun_s = triggered_s + self._camera.late_s
            self._jitter.begun(begun_s - light_s)
            if begun_s > latest_s:
                raise FrameLostError(f"{1e3 * (begun_s - latest_s):.1f} ms too late for its picture")
        except FrameLostError as lost:
            log.info("frame %d was lost (%s)", number, lost)
            self.tally.retriggered += 1
            return number, None
        self._schedule.seen()
        return number, frame

    def _while_exposed(self) -> None:
        """Whatever takes a while, for there is time."""
        self._appoint()
        self._verification.judge()

    def _appoint(self, most: int | None = None) -> None:
        """Appoint the pictures that have to leave before the one after this is exposed, `most` of them."""
        period_s = self.period_s
        while (most is None or most > 0) and self._schedule.wants(period_s):
            if self._again:
                number = self._again.pop(0)
            elif self._pictures.has(self._next) and self._may_fly(self._next):
                number, self._next = self._next, self._next + 1
            else:
                return
            self._schedule.appoint(number, self._pictures[number], period_s)
            most = None if most is None else most - 1

    def _missed(self, number: int) -> None:
        """It flies again. All land if many were missed lately, or if order matters."""
        self.missed, self._caught_in_row = self.missed + 1, 0
        self._again = sorted({*self._again, number})
        if self._jitter.fails() or self._in_order:
            self._rest_a_while()
            self._land()

    def _rest_a_while(self) -> None:
        """Some frames at rest, twice as many as the last time."""
        self._resting, self._penalty = self._penalty, min(_MOST_AT_REST, 2 * self._penalty)

    def _calm_down(self) -> None:
        self._caught_in_row += 1
        self._jitter.holds()
        if self._caught_in_row % _CALM == 0:
            self._penalty = max(1, self._penalty // 2)

    def _flies_again(self, group: Group, foreign: float) -> bool:
        """Whether a group in which others show is to fly once more: a picture that was late by chance costs no landing.

        Not one of several, which are none by chance, nor one of which frames at rest prove more than pipelined ones.
        """
        if foreign <= self._verification.tolerance or group in self._doubts or self._is_grounded(group):
            return False
        log.info("frames %s: %.1f %% are foreign", group, 100 * foreign)
        several = self._unfounded > 0 or any(self._verification.lacks(other[0]) for other in self._doubts)
        self._doubts.add(group)
        self.doubted += len(self._verification.suspects(group))
        self.missed, self._caught_in_row = self.missed + 1, 0
        if several or self._verification.is_even(group) or not self._rested.isdisjoint(group):
            return False
        self.tally.retriggered += len(group)
        self._again = sorted({*self._again, *group})
        self._verification.reopen(group)
        return True

    def _prove(self, group: Group, foreign: float, taken: dict[int, Frame]) -> None:
        """See to it that the frames of a group are its pictures', `foreign` being what is found of others.

        Frames at rest can be wrong, too; and what twice looks the same is the scene's.
        """
        if self._is_grounded(group):
            return
        verification, last = self._verification, None
        for attempt in range(ATTEMPTS):
            if foreign <= verification.tolerance:
                return
            suspects = verification.suspects(group)
            if last is None:
                self._rest_a_while()
            elif verification.is_as_before(last) and last.frames.keys() >= {*suspects}:
                break
            self.tally.retriggered += len(suspects)
            last = verification.look(suspects)
            self._land()
            # The other way around, for the same picture to be late again would look the same otherwise.
            order = suspects if attempt % 2 else suspects[::-1]
            for number, frame in self._rest(order, twice=order if attempt or verification.is_even(group) else ()):
                taken[number] = frame
                verification.note(number, frame.image)
            foreign = verification.foreign_share(group)
            log.info("frames %s, at rest: %.1f %% are foreign", group, 100 * foreign)
        self._unfounded += 1
