"""Frames of a camera that streams while a picture stands: one picture at rest, or several on their way at once.

    screen      ▏1       ▏2       ▏3
    wall             ▏1       ▏2       ▏3
    camera      ▐ … ▌▐ … ▌▐ 1 ▌▐ 1 ▌▐ … ▌▐ 2 ▌▐ 2 ▌
    frames                  ▏…    ▏…    ▏1    ▏1: the mean of both

A picture stands when frames that follow each other are alike, band by band, with nothing left in them of the picture
before (`standing.py`). On its way with others, it stays as long as flashes say that it takes until so many whole frames
of it have been exposed; of the next picture nothing may be in them, either. Where two pictures look alike, as stripes
finer than a pixel do, a picture stands some time after its light should have come.
"""

import time
from collections import deque
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from math import ceil, inf

import numpy as np

from calib.numerics import Floats, Image
from hw.errors import DeviceError
from hw.rig import Frame
from hw.timing.devices import FlippingProjector, StreamingCamera
from hw.timing.frame_reader import Arrival
from hw.timing.resting import RestingLight
from hw.timing.standing import standing
from hw.timing.stream_calibration import StreamTiming, frozen

_PATIENCE_S = 5.0  # automatic exposure comes to rest in one or two
_PATIENCE_FRAMES = 60  # on a busy computer few come
_UNSEEN_S = 0.5  # so much later than any flash's a picture's light may come, before it counts as like the one before
_FLAT, _GREY = 0.2, (0.15, 0.85)  # relative to black and white
_MOST_FROZEN = 3  # pictures that changed nothing, byte by byte
_LATELY = 16  # pictures, by which it is judged how long the next ones stay
_SPARE = 0.5  # of a frame period: flashes ask for so much too much, if all goes well; after a miss, so much is added


@dataclass(frozen=True)
class _Showing:
    """A picture that was swapped in then. Its first frame comes not before `soonest_s`; if its light is no later than
    any flash's, frames show nothing else from `latest_s` on.
    """

    begun_s: float
    soonest_s: float
    latest_s: float


@dataclass(frozen=True)
class _Run:
    """Frames of a picture that are alike, and what they look like."""

    frames: list[Arrival]
    seen: list[Floats]


def _is_unresolved(seen: Floats) -> bool:
    """Whether a frame may be of stripes that no camera pixel resolves; two such pictures look alike, others do not."""
    return bool(seen.std() < _FLAT and _GREY[0] < seen.mean() < _GREY[1])


class StandingFrames:
    """Shows pictures and takes the mean of some frames of each. `missed`: how many in flight it has caught none of."""

    def __init__(
        self, projector: FlippingProjector, camera: StreamingCamera, timing: StreamTiming, rest: RestingLight
    ) -> None:
        self._projector = projector
        self._camera = camera
        self._timing = timing
        self._sums = rest.sums
        self._standing = standing(rest)
        spread_s = max(0.0, timing.latest_s - timing.soonest_s)
        usual_s = spread_s + camera.average * timing.period_s
        self._least_s = usual_s - _SPARE * timing.period_s
        self._needed_s = deque([usual_s], _LATELY)
        self._number = -1
        self._shown: Image | None = None
        self._before: Floats | None = None
        self._newest: Image | None = None
        self._frozen = 0
        self._upcoming: Iterator[Image] = iter(())
        self._prepared: Image | None = None
        self._waiting = deque[_Showing]()
        self.missed = 0

    def at_rest(self, image: Image) -> Frame:
        """Of an image, alone. The same image (the same array) stays where it is. Raises DeviceError."""
        if image is self._shown:
            now_s = time.monotonic()
            return self._frame(self._resting(_Showing(now_s, now_s, now_s - _UNSEEN_S)))
        self._projector.prepare(image)
        run = self._resting(self._flipped(image))
        self._refuse_frozen([each.image for each in run.frames])
        return self._frame(run)

    def in_flight(self, images: Iterator[Image]) -> Generator[Frame | None]:
        """Of each image, while others are on their way; ends with None for one that was missed. Raises DeviceError.

        What is on its way when the iterator is closed has to be shown again.
        """
        self._upcoming, self._number = images, self._camera.reader.newest
        last: tuple[_Run, Frame] | None = None
        try:
            self._prepare_next()
            if self._prepared is not None:
                self._show_next()
            while self._waiting:
                run = self._caught(self._waiting[0])
                if last is not None:
                    frame = self._counted(last[1] if self._is_clean(last[0], run) else None)
                    yield frame
                    if frame is None:
                        return
                if not self._is_whole(run):
                    yield self._counted(None)
                    return
                self._waiting.popleft()
                last = run, self._frame(run)
            if last is not None:
                yield self._counted(last[1])
        finally:
            if self._waiting:
                self.forget()
            self._waiting.clear()
            self._upcoming, self._prepared = iter(()), None

    @property
    def hold_s(self) -> float:
        """How long a picture stays when others follow: as long as any of the last ones had to. One that is missed costs
        the time of several.
        """
        return max(self._least_s, *self._needed_s)

    def forget(self) -> None:
        """What is on the wall is not known, or looks otherwise by now."""
        self._shown = self._before = None

    def _resting(self, showing: _Showing) -> _Run:
        """Frames of a picture that is not followed by another."""
        self._number = self._camera.reader.newest
        for compared, (run, came_s) in enumerate(self._runs(showing)):
            late_s = came_s - showing.latest_s
            if self._is_whole(run) and (late_s > _UNSEEN_S or self._has_come(run)):
                return self._noted(run, showing)
            if not self._is_whole(run) and late_s > _PATIENCE_S and compared > _PATIENCE_FRAMES:
                break
        raise DeviceError(
            f"camera {self._camera.name}: {_PATIENCE_S:.0f} s after a picture came, its frames still change. Turn off "
            "automatic exposure, focus and white balance in the camera or its app, keep daylight and people out, then "
            "rerun."
        )

    def _caught(self, showing: _Showing) -> _Run:
        """Frames of a picture on its way, before any may show the next one; too few if there are no more."""
        found = _Run([], [])
        for run, came_s in self._runs(showing):
            end_s = self._waiting[1].soonest_s if len(self._waiting) > 1 else showing.latest_s + self.hold_s
            if came_s >= end_s:
                break
            unseen = came_s > showing.latest_s - _SPARE * self._timing.period_s and _is_unresolved(run.seen[-1])
            if self._is_whole(run) and (unseen or self._has_come(run)):
                return self._noted(run, showing)
            found = _Run(run.frames[-1:], run.seen[-1:])
        return found

    def _is_clean(self, run: _Run, following: _Run) -> bool:
        """Whether nothing of the next picture is in these frames, as its own tell, if there are any. If those show
        both, the share seems larger than it is.
        """
        if not following.seen:
            return False
        after = following.seen[-1]
        told = self._is_whole(following) or self._standing.differs(run.seen[-1], after)
        return told and self._standing.stands(after, run.seen[-1], run.seen[0])

    def _runs(self, showing: _Showing) -> Iterator[tuple[_Run, float]]:
        """After each frame that may show a picture, the last ones that are alike, and when it came."""
        begin_s = showing.latest_s if self._before is None else showing.soonest_s
        run = _Run([], [])
        while True:
            arrival = self._following()
            if arrival.came_s < begin_s:
                continue
            seen = self._sums.seen(arrival.image)
            alike = run if run.seen and self._standing.stands(self._before, run.seen[-1], seen) else _Run([], [])
            count = 1 - self._camera.average
            run = _Run([*alike.frames[count:], arrival], [*alike.seen[count:], seen])
            yield run, arrival.came_s

    def _noted(self, run: _Run, showing: _Showing) -> _Run:
        """How long the picture had to stay for these frames, if they do not show the one before as well."""
        if self._has_come(run):
            self._needed_s.append(run.frames[-1].came_s - showing.soonest_s)
        return run

    def _is_whole(self, run: _Run) -> bool:
        return len(run.frames) == self._camera.average

    def _has_come(self, run: _Run) -> bool:
        """Whether it shows another picture than the one before."""
        return self._before is None or self._standing.differs(self._before, run.seen[-1])

    def _following(self) -> Arrival:
        """The next frame; meanwhile pictures on their way leave when they are due."""
        while True:
            due_s = self._due_s()
            arrival = None
            if time.monotonic() < due_s:
                arrival = self._camera.reader.following_until(self._number, due_s)
            if arrival is not None:
                self._number = arrival.number
                return arrival
            self._show_next()

    def _due_s(self) -> float:
        """When the next picture leaves: none while more are on their way than the latency holds."""
        most = ceil(self._timing.latest_s / self.hold_s) + 1
        waits = self._prepared is None or not 0 < len(self._waiting) <= most
        return inf if waits else self._waiting[-1].begun_s + self.hold_s

    def _show_next(self) -> None:
        assert self._prepared is not None
        self._waiting.append(self._flipped(self._prepared))
        self._prepare_next()

    def _prepare_next(self) -> None:
        """Draw it while the last one is on its way."""
        self._prepared = next(self._upcoming, None)
        if self._prepared is not None:
            self._projector.prepare(self._prepared)

    def _flipped(self, image: Image) -> _Showing:
        """What was prepared is swapped in."""
        swap = self._projector.flip()
        self._shown = image
        latest_s = swap.done_s + self._timing.latest_s + self._timing.period_s
        return _Showing(swap.begun_s, swap.begun_s + self._timing.soonest_s, latest_s)

    def _frame(self, run: _Run) -> Frame:
        total = np.sum([each.image for each in run.frames], axis=0, dtype=np.uint16)
        mean = np.rint(total / np.float32(len(run.frames))).astype(np.uint8)
        self._before = self._sums.seen(mean)
        return Frame(mean, self._camera.exposure_us, run.frames[0].timestamp_ns)

    def _counted(self, frame: Frame | None) -> Frame | None:
        if frame is None:
            self.missed += 1
            self._needed_s.append(self.hold_s + _SPARE * self._timing.period_s)
        return frame

    def _refuse_frozen(self, kept: list[Image]) -> None:
        """Several pictures in a row whose frames are the last one's, byte by byte, are of no camera that works."""
        same = self._newest is not None and all(np.array_equal(image, self._newest) for image in kept)
        self._frozen = self._frozen + 1 if same else 0
        self._newest = kept[-1]
        if self._frozen >= _MOST_FROZEN:
            raise DeviceError(frozen(self._camera.name))
