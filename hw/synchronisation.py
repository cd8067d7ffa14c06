"""When to show and when to expose: a camera and a projector that know nothing of each other, made to take turns.

A picture is on the wall some tens of milliseconds after the graphics card has swapped it in; how many nobody says, so
flashes measure it. Per picture the order is then: flip, wait for the light, expose, flip to the next picture, which
starts on its way while the frame of the last one is still being transferred.

    screen      ▏picture 1                    ▏picture 2                      ▏
    wall                     ▏picture 1                      ▏picture 2
    camera                    ▐ exposure ▌ transfer           ▐ exposure ▌ transfer
"""

import logging
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, cycle
from typing import Protocol

from calib.numerics import Image
from hw.errors import DeviceError, FrameLostError
from hw.flashes import LOST_ADVICE, Flashes
from hw.rig import Camera, Frame, Projector, Rig, exposure_control

log = logging.getLogger(__name__)

# A frame that is lost so many times in a row will be lost again.
ATTEMPTS = 8
# Beyond the slowest flash: flips wait for the screen's refresh, clocks and schedulers are not exact.
_MARGIN_S = 0.004
# How much later than usual an exposure may begin after its trigger; frames that were later count as lost. Where light
# comes sooner than this, the next picture waits until the frame is there, which proves that its exposure is over.
TRIGGER_LAG_S = 0.01
_ROUNDS = 8


class BufferedProjector(Projector, Protocol):
    """A projector whose next picture can be drawn before it is shown."""

    def prepare(self, image: Image) -> None:
        """Draw an (H, W) 8-bit image where nobody sees it yet. Raises DeviceError."""

    def flip(self) -> None:
        """Show what was prepared; returns when it has left for the wall. Raises DeviceError."""


class TriggeredCamera(Camera, Protocol):
    """A camera whose frame is on its way while the next picture is shown already."""

    name: str
    exposure_s: float

    def expose(self) -> None:
        """Expose one frame, beginning now; returns when the exposure is over. Raises DeviceError."""

    def collect(self) -> Frame:
        """The frame that was exposed last. Raises DeviceError.

        Raises FrameLostError if it does not arrive whole, or was exposed more than TRIGGER_LAG_S later than others.
        """


@dataclass(frozen=True)
class Timing:
    """What was measured: `latency_s` from the end of a flip to its light; with some margin, `delay_s` is waited.

    `overlaps`: the next picture goes up while the last frame is still on its way.
    """

    latency_s: float
    delay_s: float
    overlaps: bool


class Turns:
    """Frames of images, taken in turns by a projector and a camera, and what that cost."""

    def __init__(self, projector: BufferedProjector, camera: TriggeredCamera, timing: Timing) -> None:
        self._projector = projector
        self._camera = camera
        self._delay_s = timing.delay_s
        self._overlaps = timing.overlaps
        self._flipped_s = 0.0
        self._taken = 0
        self._elapsed_s = 0.0
        self.retriggered = 0

    @property
    def exposure_s(self) -> float:
        """The camera's exposure in seconds."""
        return self._camera.exposure_s

    @property
    def taken(self) -> int:
        """How many frames there have been."""
        return self._taken

    @property
    def seconds_per_frame(self) -> float:
        """Time from one frame to the next, whatever was done with it included; 0 before the first."""
        return self._elapsed_s / max(1, self._taken)

    def frames(self, images: Iterable[Image], exposures_us: Sequence[float] = ()) -> Iterator[Frame]:
        """A frame of each image, the exposures (if there are any) taking turns; taken when it is asked for.

        Raises DeviceError, and whatever `images` raises.
        """
        exposures = cycle(exposures_us or (None,))
        begin_s, self._taken, self.retriggered = time.monotonic(), 0, 0
        upcoming: Iterator[Image | None] = chain(images, [None])
        image = self._prepare(next(upcoming))
        if image is not None:
            self._flip()
        while image is not None:
            following = self._prepare(next(upcoming))
            self._set_exposure(next(exposures))
            self._expose()
            if self._overlaps and following is not None:
                self._flip()
            frame = self._collect(image, following)
            self._taken += 1
            self._elapsed_s = time.monotonic() - begin_s
            yield frame
            image = following

    def _prepare(self, image: Image | None) -> Image | None:
        if image is not None:
            self._projector.prepare(image)
        return image

    def _flip(self) -> None:
        self._projector.flip()
        self._flipped_s = time.monotonic()

    def _set_exposure(self, exposure_us: float | None) -> None:
        """Before an exposure, when the frame before it has arrived: no frame has parts of two."""
        if exposure_us is not None:
            exposure_control(self._camera).expose_for(exposure_us)

    def _expose(self) -> None:
        time.sleep(max(0.0, self._flipped_s + self._delay_s - time.monotonic()))
        self._camera.expose()

    def _collect(self, image: Image, following: Image | None) -> Frame:
        """The frame of `image`, taken again if it was lost; afterwards `following` is on its way to the wall."""
        try:
            frame = self._camera.collect()
        except FrameLostError as lost:
            frame = self._again(image, lost)
            self._prepare(following)
        else:
            if self._overlaps:
                return frame
        if following is not None:
            self._flip()
        return frame

    def _again(self, image: Image, lost: FrameLostError) -> Frame:
        for attempt in range(1, ATTEMPTS):
            log.warning("frame %d was lost (%s), attempt %d", self._taken, lost, attempt)
            self.retriggered += 1
            self._projector.prepare(image)
            self._flip()
            self._expose()
            try:
                return self._camera.collect()
            except FrameLostError as error:
                lost = error
        raise DeviceError(
            f"camera {self._camera.name}: frame {self._taken} was lost {ATTEMPTS} times ({lost}). {LOST_ADVICE}"
        )


def measure(projector: BufferedProjector, camera: TriggeredCamera) -> Timing:
    """Flash until it is known when light of a new picture is all there, and try it out. Takes about three seconds.

    What shows in the rehearsal is a picture that came too late, or, where pictures and frames overlap, the next one
    that came too early: into the last rows of a rolling shutter, or into an exposure that began late. Raises
    DeviceError if the camera does not see the projector, or its light does not settle.
    """
    flashes = Flashes(projector, camera)
    latency_s = flashes.latency_s()
    timing = Timing(latency_s, latency_s + _MARGIN_S, overlaps=latency_s > TRIGGER_LAG_S)
    for _ in range(_ROUNDS):
        missing = flashes.largest_missing_share(Turns(projector, camera, timing).frames)
        log.info("%s: %.2f %% of the light missing", timing, 100 * missing)
        if missing < flashes.tolerance:
            return timing
        if timing.overlaps:
            timing = replace(timing, overlaps=False)
        else:
            late_s = max(_MARGIN_S, missing * camera.exposure_s)  # a tail of light fades slower than its share tells
            timing = Timing(timing.latency_s + late_s, timing.delay_s + late_s, overlaps=False)
    raise DeviceError(
        f"projector: its light does not settle: {1e3 * timing.delay_s:.0f} ms after a flip, an exposure still differs "
        f"by {100 * missing:.1f} % from one of a resting picture. Turn off whatever adapts (dynamic contrast, "
        "automatic iris, eco mode), keep daylight and people out, then rerun."
    )


@dataclass(frozen=True, kw_only=True)
class SynchronisedRig(Rig):
    """A rig of real devices, which take turns."""

    timing: Timing
    turns: Turns

    def photograph(self, images: Iterable[Image], exposures_us: Sequence[float] = ()) -> Iterator[Frame]:
        """A frame of each image, taken when it is asked for and its light is on the wall. Raises DeviceError."""
        return self.turns.frames(images, exposures_us)

    def account(self) -> Mapping[str, object]:
        """What synchronisation measured, and what the frames so far cost over what was unavoidable."""
        return {
            "synchronisation": {
                "latency_ms": round(1e3 * self.timing.latency_s, 2),
                "delay_ms": round(1e3 * self.timing.delay_s, 2),
                "overlapping": self.timing.overlaps,
                "retriggered_frames": self.turns.retriggered,
                "ms_per_frame": round(1e3 * self.turns.seconds_per_frame, 2),
                "overhead_percent": round(100 * self.overhead, 1),
            }
        }

    @property
    def overhead(self) -> float:
        """Time per frame beyond exposure and latency, relative to these."""
        return self.turns.seconds_per_frame / (self.turns.exposure_s + self.timing.latency_s) - 1


def synchronised(
    projector: BufferedProjector, camera: TriggeredCamera, identity: dict[str, str], refresh_hz: float | None = None
) -> SynchronisedRig:
    """A rig whose latency has been measured. Raises DeviceError."""
    timing = measure(projector, camera)
    known = identity | {"light after a flip": f"{1e3 * timing.latency_s:.1f} ms (measured)"}
    turns = Turns(projector, camera, timing)
    return SynchronisedRig(projector, camera, known, refresh_hz, timing=timing, turns=turns)
