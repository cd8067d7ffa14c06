"""Sequential acquisition: flip, wait for the light, expose. The flip to the next picture may overlap with the transfer.

    screen      ▏picture 1                    ▏picture 2                      ▏
    wall                     ▏picture 1                      ▏picture 2
    camera                    ▐ exposure ▌ transfer           ▐ exposure ▌ transfer

A picture with several frames stays on the wall until the last of them is exposed.
"""

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, count, cycle

from calib.numerics import Image
from hw.errors import DeviceError, FrameLostError
from hw.rig import Frames
from hw.timing.devices import ATTEMPTS, BufferedProjector, CameraGroup
from hw.timing.latency import LOST_ADVICE
from hw.timing.timed_rig import Tally

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Timing:
    """`latency_s`: measured from the end of a flip to its light; `delay_s`: the wait, with a margin.

    `overlaps`: the next picture is shown while the last frame is transferred.
    """

    latency_s: float
    delay_s: float
    overlaps: bool


class SequentialAcquisition:
    """Takes frames of images one after the other; `tally` has counts and times."""

    def __init__(self, projector: BufferedProjector, cameras: CameraGroup, timing: Timing) -> None:
        self._projector = projector
        self._cameras = cameras
        self._delay_s = timing.delay_s
        self._overlaps = timing.overlaps
        self._flipped_s = 0.0
        self.tally = Tally()

    @property
    def exposure_s(self) -> float:
        """The exposure in seconds."""
        return self._cameras.exposure_s

    def period_s(self, cycle_s: float) -> float:
        """The shortest time per frame, if the camera delivers a frame `cycle_s` after its trigger."""
        return max(cycle_s, self.exposure_s + self._delay_s) if self._overlaps else cycle_s + self._delay_s

    def frames(self, images: Iterable[Image], exposures_us: Sequence[float] = ()) -> Iterator[Frames]:
        """Yield the frames of each image, taken on request. Exposures, if there are any, are used cyclically.

        An image that follows itself (the same array) is not shown again.

        Raises DeviceError, and whatever `images` raises.
        """
        self.tally.begin()
        for frame in self.at_rest(images, exposures_us):
            self.tally.take()
            yield frame

    def at_rest(
        self, images: Iterable[Image], exposures_us: Sequence[float] = (), numbers: Iterable[int] | None = None
    ) -> Iterator[Frames]:
        """As `frames`, without counting; `numbers` name the frames in messages."""
        exposures, numbered = cycle(exposures_us or (None,)), iter(count() if numbers is None else numbers)
        upcoming: Iterator[Image | None] = chain(images, [None])
        image = next(upcoming)
        self._prepare(image)
        self._flip(image)
        while image is not None:
            following = next(upcoming)
            changed = None if following is image else following
            self._prepare(changed)
            self._set_exposure(next(exposures))
            self._expose()
            if self._overlaps:
                self._flip(changed)
            yield self._collect(image, changed, next(numbered))
            image = following

    def _prepare(self, image: Image | None) -> None:
        if image is not None:
            self._projector.prepare(image)

    def _flip(self, image: Image | None) -> None:
        """Show the prepared image, if there is one."""
        if image is not None:
            self._flipped_s = self._projector.flip().done_s

    def _set_exposure(self, exposure_us: float | None) -> None:
        """Set the exposure between two frames, so that no frame mixes two exposures."""
        if exposure_us is not None:
            self._cameras.expose_for(exposure_us)

    def _expose(self) -> None:
        time.sleep(max(0.0, self._flipped_s + self._delay_s - time.monotonic()))
        self._cameras.expose()

    def _collect(self, image: Image, changed: Image | None, number: int) -> Frames:
        """The frames of `image`, repeated if one was lost; then the prepared image is shown."""
        try:
            frames = self._cameras.collect()
        except FrameLostError as lost:
            frames = self._again(image, lost, number)
            self._prepare(changed)
        else:
            if self._overlaps:
                return frames
        self._flip(changed)
        return frames

    def _again(self, image: Image, lost: FrameLostError, number: int) -> Frames:
        for attempt in range(1, ATTEMPTS):
            log.warning("frame %d was lost (%s), attempt %d", number, str(lost), attempt)
            self.tally.retriggered += 1
            self._prepare(image)
            self._flip(image)
            self._expose()
            try:
                return self._cameras.collect()
            except FrameLostError as error:
                lost = error
        raise DeviceError(f"camera {lost.camera}: frame {number} was lost {ATTEMPTS} times ({lost}). {LOST_ADVICE}")
