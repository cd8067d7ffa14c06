"""Takes and verifies frames of a streaming camera (`stable_frames.py` takes them).

Complementary sums and parity verify that a frame shows its picture and not one that waited in a queue
(`verification.py`). Such pictures are pipelined. A missed picture, frames that fail verification, and pictures that
nothing verifies are taken at rest.

A rig of a streaming camera and a projector that is a screen.
"""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from itertools import cycle

import numpy as np

from calib.numerics import Image
from hw.errors import DeviceError
from hw.rig import NO_REDUNDANCY, Frame, Frames, Redundancy, exposure_control
from hw.timing.devices import ATTEMPTS, FlippingProjector, StreamingCamera
from hw.timing.redundancy import with_parity
from hw.timing.stable_frames import StableFrames
from hw.timing.stream_calibration import StreamTiming, calibrate_stream
from hw.timing.timed_rig import Appearance, Tally, TimedRig, appearance, changes, is_another_view, reference_picture
from hw.timing.verification import FrameVerification, Group, NumberedPictures, RestingLight

log = logging.getLogger(__name__)

_MOST_UNFOUNDED = 3  # failed verifications that the scene caused, after which sums are not used any more


class StreamAcquisition:
    """Takes verified frames. `tally`: counts and times; `doubted`: how many frames failed verification at first.

    A capture begins and ends with a reference picture, which shows automatic `changes` of the camera in per cent.
    """

    def __init__(
        self, projector: FlippingProjector, camera: StreamingCamera, timing: StreamTiming, rest: RestingLight
    ) -> None:
        self.stable_frames = StableFrames(projector, camera, timing, rest)
        self._camera = camera
        self._rest = rest
        width, height = projector.size
        self._blank = np.zeros((height, width), np.uint8)
        self._reference = reference_picture(projector.size)
        self.changes: Mapping[str, float] = {}
        self._unfounded = 0
        self.tally = Tally()
        self.doubted = 0

    def frames(
        self, images: Iterable[Image], exposures_us: Sequence[float] = (), redundancy: Redundancy = NO_REDUNDANCY
    ) -> Iterator[Frame]:
        """Yield a verified frame of each image, in order. With `exposures_us`, which are used cyclically, frames are
        only checked to be stable.

        Raises DeviceError, and whatever `images` raises.
        """
        first = self._appearance() if redundancy and not exposures_us else None
        self.tally.begin()
        self.doubted = self._unfounded = self.stable_frames.missed = 0
        if exposures_us:
            for image, exposure_us in zip(images, cycle(exposures_us)):  # cycle has no end
                exposure_control(self._camera).expose_for(exposure_us)
                self.stable_frames.forget()
                self.tally.take()
                yield self.stable_frames.at_rest(image)
            return
        numbered = with_parity(images, redundancy)
        self._pictures = NumberedPictures(numbered.images)
        self._verification = FrameVerification([self._rest.sums], self._pictures, numbered.level, numbered.even)
        self._even = {number for group in numbered.even for number in group}
        self._taken: dict[int, Frame] = {}
        following = 0
        for _ in self._all(first):
            while following in self._taken and not self._verification.lacks(following):
                frame = self._taken.pop(following)
                if following not in numbered.added:
                    self.tally.take()
                    yield frame
                following += 1
                self._pictures.forget(following)
        if first is not None:
            self.changes = changes(first, self._same_view(first))

    def _appearance(self) -> Appearance:
        return appearance(self.stable_frames.at_rest(self._reference).image, self._rest.lit)

    def _same_view(self, first: Appearance) -> Appearance:
        """The reference picture as it looks now. Raises DeviceError if it has changed. The frames' size does not show
        this, because OpenCV silently scales the frames of a stream to the size of the first.
        """
        now = self._appearance()
        if is_another_view(first, now):
            raise DeviceError(
                f"camera {self._camera.name}: it sees another picture than when the capture began: it was moved or "
                "turned, or it sends frames of another size or shape. Put it back as it was, then rerun."
            )
        return now

    def _all(self, first: Appearance | None) -> Iterator[None]:
        """Take all frames in order; yields after each one and its repetitions."""
        number = 0
        while self._pictures.has(number):
            with closing(self.stable_frames.pipelined(self._verifiable(number))) as frames:
                frame = None
                for frame in frames:
                    if frame is None:
                        break
                    self._note(number, frame, number - 1)
                    self._verification.judge()
                    number += 1
                    if self._is_doubtful():
                        break
                    self._verify(first)
                    yield
            if frame is None and self._pictures.has(number):
                self.tally.retriggered += self._may_be_pipelined(number)
                self._note(number, self.stable_frames.at_rest(self._pictures[number]), number - 1)
                self._verification.judge()
                number += 1
            self._verify(first)
            yield

    def _verifiable(self, number: int) -> Iterator[Image]:
        """Successive pictures from this number on that can be verified."""
        while self._pictures.has(number) and self._may_be_pipelined(number):
            yield self._pictures[number]
            number += 1

    def _may_be_pipelined(self, number: int) -> bool:
        return self._unfounded < _MOST_UNFOUNDED and self._verification.lacks(number)

    def _note(self, number: int, frame: Frame, before: int) -> None:
        """Store the frame of a picture that was shown after the picture number `before`, −1 for none.

        A stable frame contains no share of another picture, but may show another one altogether. Parity finds that,
        so the edges of other pictures are not searched.
        """
        self._taken[number] = frame
        self._verification.set_neighbours(number, [] if number in self._even or before < 0 else [before])
        self._verification.note(number, [frame])

    def _is_doubtful(self) -> bool:
        verification = self._verification
        return any(verification.foreign(group) > 1 for group in verification.judged)

    def _verify(self, first: Appearance | None) -> None:
        for group in [*self._verification.judged]:
            self._prove(group, first)

    def _prove(self, group: Group, first: Appearance | None) -> None:
        """Repeat frames that fail verification, unless the scene is the cause. `first`: the reference picture, to check
        that the camera was not moved.
        """
        verification = self._verification
        for attempt in range(ATTEMPTS):
            foreign = verification.foreign(group)
            if foreign <= 1 or self._unfounded >= _MOST_UNFOUNDED:
                break
            suspects = verification.suspects(group)
            log.info("frames %s: foreign by %.1f times the tolerance", group, foreign)
            self.doubted += 0 if attempt else len(suspects)
            self.tally.retriggered += len(suspects)
            before_repeating = verification.snapshot(suspects)
            # A late frame arrives by then, or is so late that verification finds it.
            self.stable_frames.at_rest(self._blank)
            last = -1
            for number in suspects if attempt % 2 else suspects[::-1]:
                self._note(number, self.stable_frames.at_rest(self._pictures[number]), last)
                last = number
            if verification.is_unchanged(before_repeating):
                if first is not None:
                    self._same_view(first)
                self._unfounded += 1
                break
        verification.settle(group)


@dataclass(eq=False, kw_only=True)
class StreamedRig(TimedRig):
    """A rig with a streaming camera, which takes stable frames."""

    lost_advice = "Send smaller or fewer frames, by cable where there is one."

    streaming: StreamingCamera
    timing: StreamTiming
    rest: RestingLight
    acquisition: StreamAcquisition
    _lost_before: tuple[int, int] = field(default=(0, 0), init=False)
    """Counts of repeated and dropped frames at the begin of the last capture."""

    @property
    def least_s(self) -> float:
        """Latency and two frame periods, the time of a single picture; pipelined pictures can take less."""
        return self.timing.soonest_s + 2 * self.timing.period_s

    def account(self) -> Mapping[str, object]:
        """As for every timed rig, and automatic changes of the camera."""
        changed = {"after_white_percent": round(100 * self.timing.adapted, 1), **self.acquisition.changes}
        return {**super().account(), "camera_changed": changed}

    def _measured(self) -> Mapping[str, object]:
        reader = self.streaming.reader
        return {
            "frame_period_ms": round(1e3 * self.timing.period_s, 2),
            "missed_in_flight": self.acquisition.stable_frames.missed,
            "doubted_frames": self.acquisition.doubted,
            "repeated_frames": reader.repeated - self._lost_before[0],
            "dropped_frames": reader.dropped - self._lost_before[1],
            "averaged_frames": self.streaming.average,
        }

    def _acquired(
        self, images: Iterable[Image], exposures_us: Sequence[float], redundancy: Redundancy
    ) -> Iterator[Frames]:
        reader = self.streaming.reader
        self._lost_before = reader.repeated, reader.dropped
        return ((frame,) for frame in self.acquisition.frames(images, exposures_us, redundancy))


def streamed(
    projector: FlippingProjector, camera: StreamingCamera, identity: dict[str, str], refresh_hz: float | None = None
) -> StreamedRig:
    """Calibrate the latency, which takes about seven seconds, and return the rig.

    Raises DeviceError if the camera does not see the projector, is frozen, or delivers nothing.
    """
    timing, rest = calibrate_stream(projector, camera)
    acquisition = StreamAcquisition(projector, camera, timing, rest)
    known = identity | {"light after a flip": f"{1e3 * timing.soonest_s:.1f} ms (measured, with the camera's delay)"}
    return StreamedRig(
        projector,
        camera,
        known,
        refresh_hz,
        latency_s=timing.soonest_s,
        tally=acquisition.tally,
        streaming=camera,
        timing=timing,
        rest=rest,
        acquisition=acquisition,
    )
