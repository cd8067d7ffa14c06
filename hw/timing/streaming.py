"""Frames of pictures from a camera that streams: a picture is shown until some frames prove that it stands.

    screen      ▏1                               ▏2
    wall               ▏1                               ▏2
    camera      ▐ … ▌▐ … ▌▐ 1 ▌▐ 1 ▌▐ 1 ▌▐ 1 ▌▐ 1 ▌▐ … ▌
    frames               …     ▏…    ▏1    ▏1: the mean of both

A picture stands when two frames that follow each other are alike, band by band, with nothing left in them of the
picture before (`standing.py`). Where two pictures look alike, as stripes finer than a pixel do, it stands some
time after its light should have come. That it is the right one, and not one that waited in a queue, prove the pictures
that light every place alike together, or an even number of times (`verification.py`); frames that do not add up are
taken again, the other way around.
"""

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from itertools import cycle

import numpy as np

from calib.numerics import Floats, Image
from hw.errors import DeviceError
from hw.rig import Frame, exposure_control
from hw.timing.devices import ATTEMPTS, FlippingProjector, StreamingCamera
from hw.timing.frame_reader import Arrival
from hw.timing.numbered_pictures import NumberedPictures
from hw.timing.parity_check import with_parity
from hw.timing.resting import RestingLight
from hw.timing.standing import standing
from hw.timing.stream_calibration import StreamTiming, frozen
from hw.timing.timed_rig import Tally
from hw.timing.verification import FrameVerification, Group

log = logging.getLogger(__name__)

_PATIENCE_S = 5.0  # automatic exposure comes to rest in one or two
_UNSEEN_S = 0.5  # so much later than any flash's a picture's light may come, before it counts as like the one before
_MOST_UNFOUNDED = 3  # doubts that were the scene's own: where sums are never level, they prove nothing
_MOST_FROZEN = 3  # pictures that changed nothing, byte by byte


class StreamAcquisition:
    """Takes the frames; `tally` is what they cost, `doubted` how many did not add up with others at first."""

    def __init__(
        self, projector: FlippingProjector, camera: StreamingCamera, timing: StreamTiming, rest: RestingLight
    ) -> None:
        self._projector = projector
        self._camera = camera
        self._timing = timing
        self._sums = rest.sums
        self._standing = standing(rest)
        width, height = projector.size
        self._blank = np.zeros((height, width), np.uint8)
        self._shown: Image | None = None
        self._prepared: Image | None = None
        self._before: Floats | None = None
        self._newest: Image | None = None
        self._frozen = self._unfounded = 0
        self.tally = Tally()
        self.doubted = 0

    def frames(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float] = (),
        level: Sequence[Sequence[int]] = (),
        unpaired: Sequence[Sequence[int]] = (),
    ) -> Iterator[Frame]:
        """A frame of each image, when it is verified. `level`: the numbers of images that light every place alike
        together; `unpaired`: of images of black and white that one more picture is to verify. With `exposures_us`,
        which take turns, nothing is verified but that each picture stands.

        Raises DeviceError, and whatever `images` raises.
        """
        self.tally.begin()
        self.doubted = self._unfounded = 0
        if exposures_us:
            for image, exposure_us in zip(images, cycle(exposures_us)):  # cycle has no end
                exposure_control(self._camera).expose_for(exposure_us)
                self._before, self._shown = None, None  # of another exposure
                self.tally.take()
                yield self.frame(image)
            return
        shown = with_parity(images, level, unpaired)
        self._pictures = NumberedPictures(shown.images)
        self._verification = FrameVerification(self._sums, self._pictures, shown.level, shown.even)
        self._even = {each for group in shown.even for each in group}
        self._taken: dict[int, Frame] = {}
        self._last: list[int] = []
        number = following = 0
        while self._pictures.has(number):
            self._take(number)
            self._verification.judge()
            for group in [*self._verification.judged]:
                self._verify(group)
            number += 1
            while following in self._taken and not self._verification.lacks(following):
                frame = self._taken.pop(following)
                if following not in shown.added:
                    self.tally.take()
                    yield frame
                following += 1
                self._pictures.forget(following)

    def frame(self, image: Image, following: Image | None = None) -> Frame:
        """The mean of some frames while an image stands; the `following` one is prepared meanwhile. Raises DeviceError.

        The same image (the same array) stays where it is.
        """
        other = image is not self._shown
        earliest_s, latest_s = self._show(image) if other else (0.0, time.monotonic() - _UNSEEN_S)
        if following is not None and following is not image:
            self._projector.prepare(following)
            self._prepared = following
        kept: list[Arrival] = []
        before, last, number = self._before, np.zeros(0), self._camera.reader.newest
        while len(kept) < self._camera.average:
            arrival = self._camera.reader.following(number)
            number = arrival.number
            if arrival.came_s < earliest_s:
                continue
            now = self._sums.seen(arrival.image)
            if not kept or not self._standing.stands(before, last, now):
                self._refuse_unrest(arrival.came_s - latest_s)
                kept = []
            changed = before is None or self._standing.differs(before, now)
            if changed or arrival.came_s > latest_s + _UNSEEN_S:
                kept.append(arrival)
            last = now
        if other:
            self._refuse_frozen([each.image for each in kept])
        mean = np.rint(np.mean([each.image for each in kept], axis=0)).astype(np.uint8)
        self._before = self._sums.seen(mean)
        return Frame(mean, self._camera.exposure_us, kept[0].timestamp_ns)

    def _show(self, image: Image) -> tuple[float, float]:
        """From when on a frame may show the image alone, and by when at the latest each does: both are the same where
        it is not known what frames showed before.
        """
        if image is not self._prepared:
            self._projector.prepare(image)
        swap = self._projector.flip()
        self._prepared, self._shown = None, image
        latest_s = swap.done_s + self._timing.latest_s + self._timing.period_s
        return (latest_s if self._before is None else swap.begun_s + self._timing.soonest_s), latest_s

    def _take(self, number: int) -> None:
        following = self._pictures[number + 1] if self._pictures.has(number + 1) else None
        self._note(number, self.frame(self._pictures[number], following))

    def _note(self, number: int, frame: Frame) -> None:
        """A frame that stood holds no share of another picture, but it may be another picture altogether. Of those
        without inverses that shows in the parity; edges of others are not looked for.
        """
        self._taken[number] = frame
        self._verification.stood_beside(number, [] if number in self._even else self._last)
        self._verification.note(number, frame.image)
        self._last = [number]

    def _verify(self, group: Group) -> None:
        """Take frames again that do not add up, unless it is the scene that makes them so."""
        verification = self._verification
        for attempt in range(ATTEMPTS):
            foreign = verification.foreign_share(group)
            if foreign <= verification.tolerance or self._unfounded >= _MOST_UNFOUNDED:
                break
            suspects = verification.suspects(group)
            log.info("frames %s: %.1f %% are foreign", group, 100 * foreign)
            self.doubted += 0 if attempt else len(suspects)
            self.tally.retriggered += len(suspects)
            looked = verification.look(suspects)
            self.frame(self._blank)  # what was late is there by then, or so late that it shows
            for number in suspects if attempt % 2 else suspects[::-1]:
                self._note(number, self.frame(self._pictures[number]))
            if verification.is_as_before(looked):
                self._unfounded += 1
                break
        verification.settle(group)

    def _refuse_unrest(self, late_s: float) -> None:
        if late_s > _PATIENCE_S:
            raise DeviceError(
                f"camera {self._camera.name}: {_PATIENCE_S:.0f} s after a picture came, its frames still change. Turn "
                "off automatic exposure, focus and white balance in the camera or its app, keep daylight and people "
                "out, then rerun."
            )

    def _refuse_frozen(self, kept: Sequence[Image]) -> None:
        """Several pictures in a row whose frames are the last one's, byte by byte, are of no camera that works."""
        same = self._newest is not None and all(np.array_equal(image, self._newest) for image in kept)
        self._frozen = self._frozen + 1 if same else 0
        self._newest = kept[-1]
        if self._frozen >= _MOST_FROZEN:
            raise DeviceError(frozen(self._camera.name))
