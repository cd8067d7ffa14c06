"""Frames of pictures from a camera that streams, each verified (`standing_frames.py` has how they are taken).

That a frame is of the right picture, and not of one that waited in a queue, prove the pictures that light every place
alike together, or an even number of times (`verification.py`). Those are taken while others are on their way; where one
was missed, or frames do not add up, all land, and it is taken at rest. What nothing proves is taken at rest.
"""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import cycle

import numpy as np

from calib.numerics import Image
from hw.errors import DeviceError
from hw.rig import Frame, exposure_control
from hw.timing.automatics import Appearance, appearance, changes, is_another_view, reference_picture
from hw.timing.devices import ATTEMPTS, FlippingProjector, StreamingCamera
from hw.timing.numbered_pictures import NumberedPictures
from hw.timing.parity_check import with_parity
from hw.timing.resting import RestingLight
from hw.timing.standing_frames import StandingFrames
from hw.timing.stream_calibration import StreamTiming
from hw.timing.timed_rig import Tally
from hw.timing.verification import FrameVerification, Group

log = logging.getLogger(__name__)

_MOST_UNFOUNDED = 3  # doubts that were the scene's own: where sums are never level, they prove nothing


class StreamAcquisition:
    """Takes the frames; `tally` is what they cost, `doubted` how many did not add up with others at first, `standing`
    how they are taken. A capture begins and ends with one picture that shows the `changes` that the camera has made by
    itself in between, in per cent.
    """

    def __init__(
        self, projector: FlippingProjector, camera: StreamingCamera, timing: StreamTiming, rest: RestingLight
    ) -> None:
        self.standing = StandingFrames(projector, camera, timing, rest)
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
        first = self._appearance() if (level or unpaired) and not exposures_us else None
        self.tally.begin()
        self.doubted = self._unfounded = self.standing.missed = 0
        if exposures_us:
            for image, exposure_us in zip(images, cycle(exposures_us)):  # cycle has no end
                exposure_control(self._camera).expose_for(exposure_us)
                self.standing.forget()
                self.tally.take()
                yield self.standing.at_rest(image)
            return
        shown = with_parity(images, level, unpaired)
        self._pictures = NumberedPictures(shown.images)
        self._verification = FrameVerification(self._rest.sums, self._pictures, shown.level, shown.even)
        self._even = {each for group in shown.even for each in group}
        self._taken: dict[int, Frame] = {}
        following = 0
        for _ in self._all(first):
            while following in self._taken and not self._verification.lacks(following):
                frame = self._taken.pop(following)
                if following not in shown.added:
                    self.tally.take()
                    yield frame
                following += 1
                self._pictures.forget(following)
        if first is not None:
            self.changes = changes(first, self._same_view(first))

    def _appearance(self) -> Appearance:
        return appearance(self.standing.at_rest(self._reference).image, self._rest.lit)

    def _same_view(self, first: Appearance) -> Appearance:
        """How the reference picture looks by now. Raises DeviceError if the camera sees another one. That is not seen
        in the size of its frames: OpenCV makes those of a stream as large as the first were, and tells nobody.
        """
        now = self._appearance()
        if is_another_view(first, now):
            raise DeviceError(
                f"camera {self._camera.name}: it sees another picture than when the capture began: it was moved or "
                "turned, or it sends frames of another size or shape. Put it back as it was, then rerun."
            )
        return now

    def _all(self, first: Appearance | None) -> Iterator[None]:
        """Take them in their order; after each one, and what had to be taken again."""
        number = 0
        while self._pictures.has(number):
            with closing(self.standing.in_flight(self._flying(number))) as flight:
                frame = None
                for frame in flight:
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
                self.tally.retriggered += self._may_fly(number)
                self._note(number, self.standing.at_rest(self._pictures[number]), number - 1)
                self._verification.judge()
                number += 1
            self._verify(first)
            yield

    def _flying(self, number: int) -> Iterator[Image]:
        """Pictures in a row, from that one on, that others prove."""
        while self._pictures.has(number) and self._may_fly(number):
            yield self._pictures[number]
            number += 1

    def _may_fly(self, number: int) -> bool:
        return self._unfounded < _MOST_UNFOUNDED and self._verification.lacks(number)

    def _note(self, number: int, frame: Frame, before: int) -> None:
        """Take in the frame of a picture, which was shown after that of the number `before`, if there is one.

        A frame that stood holds no share of another picture, but it may be another picture altogether. Of those
        without inverses that shows in the parity; edges of others are not looked for.
        """
        self._taken[number] = frame
        self._verification.stood_beside(number, [] if number in self._even or before < 0 else [before])
        self._verification.note(number, frame.image)

    def _is_doubtful(self) -> bool:
        verification = self._verification
        return any(verification.foreign_share(group) > verification.tolerance for group in verification.judged)

    def _verify(self, first: Appearance | None) -> None:
        for group in [*self._verification.judged]:
            self._prove(group, first)

    def _prove(self, group: Group, first: Appearance | None) -> None:
        """Take frames again that do not add up, unless it is the scene that makes them so, as the camera sees it at
        `first`.
        """
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
            self.standing.at_rest(self._blank)  # what was late is there by then, or so late that it shows
            last = -1
            for number in suspects if attempt % 2 else suspects[::-1]:
                self._note(number, self.standing.at_rest(self._pictures[number]), last)
                last = number
            if verification.is_as_before(looked):
                if first is not None:
                    self._same_view(first)
                self._unfounded += 1
                break
        verification.settle(group)
