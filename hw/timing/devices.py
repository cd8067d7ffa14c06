"""Interfaces of projectors and cameras that are synchronised without a trigger line."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from calib.numerics import Image
from hw.cameras import NamedCamera
from hw.rig import Frame, Projector
from hw.timing.frame_reader import FrameReader

# Attempts for one frame before giving up.
ATTEMPTS = 8
# Longest delay of an exposure beyond the usual; later frames count as lost. If the latency is shorter than this, the
# next picture is shown only after the frame has arrived, so that its exposure is over.
TRIGGER_LAG_S = 0.01


@dataclass(frozen=True)
class Swap:
    """A swap of buffers happened between `begun_s` and `done_s`, as measured by the process that did it.

    Both in seconds of the monotonic clock, which all processes share.
    """

    begun_s: float
    done_s: float


def nothing() -> None:
    """Do nothing."""


class FlippingProjector(Projector, Protocol):
    """A projector with a back buffer."""

    def prepare(self, image: Image) -> None:
        """Draw an (H, W) 8-bit image into the back buffer. Raises DeviceError."""

    def flip(self) -> Swap:
        """Show the prepared image; returns after the swap. Raises DeviceError."""


class BufferedProjector(FlippingProjector, Protocol):
    """A projector that can also show images at scheduled times."""

    def show_at(self, image: Image, when_s: float) -> None:
        """Queue an image to be shown at `when_s` of the monotonic clock, or as soon as it is drawn.

        Returns at once; several images may be queued. Raises DeviceError.
        """

    def shown(self, *, wait: bool) -> Swap | None:
        """The oldest swap of `show_at` that was not returned yet. Without `wait`, None if none has happened.

        Raises DeviceError.
        """


class TriggeredCamera(NamedCamera, Protocol):
    """A triggered camera, which transfers a frame while the next picture is shown."""

    exposure_s: float
    late_s: float
    """Delay from trigger to exposure of the last frame, beyond the smallest recent one, by the camera's clock."""

    @property
    def wait_s(self) -> float:
        """Longest time from `expose` to the begin of the exposure, for cameras that run freely.

        Infinite if unknown.
        """

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        """Expose one frame, beginning now or later, and wait until the exposure is over. Raises DeviceError.

        Returns the time of the trigger, or of the begin where there is none, in seconds of the monotonic clock.
        `meanwhile` is called during the exposure, and may take longer: further cameras expose in it.
        """

    def collect(self) -> Frame:
        """The last exposed frame. Raises DeviceError.

        Raises FrameLostError if it does not arrive complete, or was exposed more than TRIGGER_LAG_S later than usual.
        """


class StreamingCamera(NamedCamera, Protocol):
    """A camera whose frames arrive continuously and cannot be triggered. Its `reader` receives them.

    `average`: how many frames of a picture are averaged, two or more.
    """

    average: int

    @property
    def reader(self) -> FrameReader:
        """Receives its frames."""

    @property
    def exposure_us(self) -> float | None:
        """The exposure in microseconds, None if unknown."""


def whole_periods(exposure_us: float, refresh_hz: float) -> tuple[float, int]:
    """The nearest exposure that is a whole number of refresh periods, in microseconds, and that number (at least 1).

    A projector builds each picture up over a refresh period, so other exposures would miss a part of it in some rows.
    """
    period_us = 1e6 / refresh_hz
    periods = max(1, round(exposure_us / period_us))
    return periods * period_us, periods
