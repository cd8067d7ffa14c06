"""Takes stable frames of a streaming camera: of one picture at rest, or of several pipelined pictures.

    screen      ▏1       ▏2       ▏3
    wall             ▏1       ▏2       ▏3
    camera      ▐ … ▌▐ … ▌▐ 1 ▌▐ 1 ▌▐ … ▌▐ 2 ▌▐ 2 ▌
    frames                  ▏…    ▏…    ▏1    ▏1: the mean of both

A picture is stable when successive frames are alike, band by band, without a share of the previous picture
(`stream_calibration.py`). Pipelined, each picture stays as long as the calibration says that the required number of
complete frames takes; they must not contain the next picture, either. Where two pictures look alike, such as stripes
finer than a camera pixel, a picture counts as stable some time after its light should have arrived.
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
from hw.timing.stream_calibration import StreamTiming, frozen, stability_test
from hw.timing.verification import RestingLight

_PATIENCE_S = 5.0  # automatic exposure settles in one or two
_PATIENCE_FRAMES = 60  # a busy computer receives few frames in that time
_UNSEEN_S = 0.5  # delay beyond the slowest flash after which a picture counts as equal to the previous one
_FLAT, _GREY = 0.2, (0.15, 0.85)  # relative to black and white
_MOST_FROZEN = 3  # pictures that changed nothing, byte by byte
_LATELY = 16  # pictures that determine how long the next ones stay
_SPARE = 0.5  # of a frame period: less than flashes suggest at best; more after a miss


@dataclass(frozen=True)
class _ShownPicture:
    """A picture swapped in at `begun_s`. Its first frame arrives no sooner than `soonest_s`; by the calibration, frames
    show nothing else from `latest_s` on.
    """

    begun_s: float
    soonest_s: float
    latest_s: float


@dataclass(frozen=True)
class _Run:
    """Successive frames that are alike, and their brightness."""

    frames: list[Arrival]
    levels: list[Floats]


def _is_unresolved(levels: Floats) -> bool:
    """Whether a frame may show stripes that the camera does not resolve; two such pictures look alike."""
    return bool(levels.std() < _FLAT and _GREY[0] < levels.mean() < _GREY[1])


class StableFrames:
    """Shows pictures and averages some frames of each. `missed`: how many pipelined pictures had no stable frames."""

    def __init__(
        self, projector: FlippingProjector, camera: StreamingCamera, timing: StreamTiming, rest: RestingLight
    ) -> None:
        self._projector = projector
        self._camera = camera
        self._timing = timing
        self._sums = rest.sums
        self._stability = stability_test(rest)
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
        self._waiting = deque[_ShownPicture]()
        self.missed = 0

    def at_rest(self, image: Image) -> Frame:
        """The frame of a single image; the same array as before is not shown again. Raises DeviceError."""
        if image is self._shown:
            now_s = time.monotonic()
            return self._frame(self._resting(_ShownPicture(now_s, now_s, now_s - _UNSEEN_S)))
        self._projector.prepare(image)
        run = self._resting(self._flipped(image))
        self._refuse_frozen([frame.image for frame in run.frames])
        return self._frame(run)

    def pipelined(self, images: Iterator[Image]) -> Generator[Frame | None]:
        """Frames of pipelined images; ends with None after a missed one. Raises DeviceError.

        Images still on their way when the iterator is closed must be shown again.
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
        """How long a pipelined picture stays: as long as any of the last ones had to, because a miss costs more."""
        return max(self._least_s, *self._needed_s)

    def forget(self) -> None:
        """Forget the last picture: the wall, or its appearance, has changed."""
        self._shown = self._before = None

    def _resting(self, showing: _ShownPicture) -> _Run:
        """Wait for stable frames of a picture that no other follows."""
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

    def _caught(self, showing: _ShownPicture) -> _Run:
        """Frames of a pipelined picture before the next one may appear; fewer than wanted if it was missed."""
        started = _Run([], [])
        for run, came_s in self._runs(showing):
            end_s = self._waiting[1].soonest_s if len(self._waiting) > 1 else showing.latest_s + self.hold_s
            if came_s >= end_s:
                break
            unseen = came_s > showing.latest_s - _SPARE * self._timing.period_s and _is_unresolved(run.levels[-1])
            if self._is_whole(run) and (unseen or self._has_come(run)):
                return self._noted(run, showing)
            started = _Run(run.frames[-1:], run.levels[-1:])
        return started

    def _is_clean(self, run: _Run, following: _Run) -> bool:
        """Whether these frames contain no share of the next picture, compared with the next picture's own frames. If
        those show both pictures, the share is overestimated, which is safe.
        """
        if not following.levels:
            return False
        after = following.levels[-1]
        comparable = self._is_whole(following) or self._stability.differs(run.levels[-1], after)
        return comparable and self._stability.is_stable(after, run.levels[-1], run.levels[0])

    def _runs(self, showing: _ShownPicture) -> Iterator[tuple[_Run, float]]:
        """After each frame that may show a picture: the last frames that are alike, and its time of arrival."""
        begin_s = showing.latest_s if self._before is None else showing.soonest_s
        run = _Run([], [])
        while True:
            arrival = self._following()
            if arrival.came_s < begin_s:
                continue
            brightness = self._sums.brightness(arrival.image)
            alike = (
                run
                if run.levels and self._stability.is_stable(self._before, run.levels[-1], brightness)
                else _Run([], [])
            )
            count = 1 - self._camera.average
            run = _Run([*alike.frames[count:], arrival], [*alike.levels[count:], brightness])
            yield run, arrival.came_s

    def _noted(self, run: _Run, showing: _ShownPicture) -> _Run:
        """Record how long the picture had to stay, if its frames differ from the previous picture."""
        if self._has_come(run):
            self._needed_s.append(run.frames[-1].came_s - showing.soonest_s)
        return run

    def _is_whole(self, run: _Run) -> bool:
        return len(run.frames) == self._camera.average

    def _has_come(self, run: _Run) -> bool:
        """Whether the frames differ from the previous picture."""
        return self._before is None or self._stability.differs(self._before, run.levels[-1])

    def _following(self) -> Arrival:
        """Wait for the next frame, and show pictures that are due meanwhile."""
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
        """When to show the next picture; infinite while enough are on their way to cover the latency."""
        most = ceil(self._timing.latest_s / self.hold_s) + 1
        waits = self._prepared is None or not 0 < len(self._waiting) <= most
        return inf if waits else self._waiting[-1].begun_s + self.hold_s

    def _show_next(self) -> None:
        assert self._prepared is not None
        self._waiting.append(self._flipped(self._prepared))
        self._prepare_next()

    def _prepare_next(self) -> None:
        """Draw the next picture while the last one is on its way."""
        self._prepared = next(self._upcoming, None)
        if self._prepared is not None:
            self._projector.prepare(self._prepared)

    def _flipped(self, image: Image) -> _ShownPicture:
        """Swap in the prepared picture."""
        swap = self._projector.flip()
        self._shown = image
        latest_s = swap.done_s + self._timing.latest_s + self._timing.period_s
        return _ShownPicture(swap.begun_s, swap.begun_s + self._timing.soonest_s, latest_s)

    def _frame(self, run: _Run) -> Frame:
        total = np.sum([frame.image for frame in run.frames], axis=0, dtype=np.uint16)
        mean = np.rint(total / np.float32(len(run.frames))).astype(np.uint8)
        self._before = self._sums.brightness(mean)
        return Frame(mean, self._camera.exposure_us, run.frames[0].timestamp_ns)

    def _counted(self, frame: Frame | None) -> Frame | None:
        if frame is None:
            self.missed += 1
            self._needed_s.append(self.hold_s + _SPARE * self._timing.period_s)
        return frame

    def _refuse_frozen(self, kept: list[Image]) -> None:
        """Raise DeviceError if the frames of several successive pictures are identical, byte by byte."""
        same = self._newest is not None and all(np.array_equal(image, self._newest) for image in kept)
        self._frozen = self._frozen + 1 if same else 0
        self._newest = kept[-1]
        if self._frozen >= _MOST_FROZEN:
            raise DeviceError(frozen(self._camera.name))
