"""What a projector and a camera that share no trigger line have to do and to tell, so that they can be timed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from calib.numerics import Image
from hw.cameras import NamedCamera
from hw.rig import Frame, Projector
from hw.timing.frame_reader import FrameReader

# A frame that is lost so many times in a row will be lost again.
ATTEMPTS = 8
# How much later than usual an exposure may begin after its trigger; frames that were later count as lost. Where light
# comes sooner than this, the next picture waits until the frame is there, which proves that its exposure is over.
TRIGGER_LAG_S = 0.01


@dataclass(frozen=True)
class Swap:
    """When a picture was swapped in, by the process that did it: not before `begun_s`, not after `done_s`.

    Both in seconds of the monotonic clock, which all processes share.
    """

    begun_s: float
    done_s: float


def nothing() -> None:
    """There is nothing to do meanwhile."""


class FlippingProjector(Projector, Protocol):
    """A projector whose next picture can be drawn before it is shown."""

    def prepare(self, image: Image) -> None:
        """Draw an (H, W) 8-bit image where nobody sees it yet. Raises DeviceError."""

    def flip(self) -> Swap:
        """Show what was prepared; returns when it has left for the wall. Raises DeviceError."""


class BufferedProjector(FlippingProjector, Protocol):
    """The same, which also keeps a schedule."""

    def show_at(self, image: Image, when_s: float) -> None:
        """Draw an image when those before it have been shown, and show it at a moment, or as soon as it is drawn.

        Returns at once: several may be waiting for their moments. Raises DeviceError.
        """

    def shown(self, *, wait: bool) -> Swap | None:
        """The oldest swap of `show_at` that was not told yet; None if there is none so far, unless it is waited for.

        Raises DeviceError.
        """


class TriggeredCamera(NamedCamera, Protocol):
    """A camera whose frame is on its way while the next picture is shown already."""

    exposure_s: float
    late_s: float
    """By how much more than the least of late the exposure of the last frame came after its trigger, as far as the
    camera's clock tells."""

    @property
    def wait_s(self) -> float:
        """How long after `expose` is called its exposure begins at most, where the camera does not wait to be told.

        Infinite if nobody knows.
        """

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        """Expose one frame, beginning now or later; returns when the exposure is over. Raises DeviceError.

        Returns the moment of the trigger, or of the begin where there is none, in seconds of the monotonic clock.
        `meanwhile` is called once the camera has been told: what it takes, up to an exposure, costs no time.
        """

    def collect(self) -> Frame:
        """The frame that was exposed last. Raises DeviceError.

        Raises FrameLostError if it does not arrive whole, or was exposed more than TRIGGER_LAG_S later than others.
        """


class StreamingCamera(NamedCamera, Protocol):
    """A camera whose frames come by themselves, and cannot be asked for. Its `reader` has them as they come.

    `average`: of so many frames of a picture the mean is wanted, two or more. `exposure_us`: of all frames from now on,
    None if it is not known.
    """

    average: int

    @property
    def reader(self) -> FrameReader:
        """Its frames as they come."""

    @property
    def exposure_us(self) -> float | None:
        """In microseconds."""
