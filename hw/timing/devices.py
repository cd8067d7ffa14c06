"""Interfaces of projectors and cameras that are synchronised without a trigger line.

Triggered cameras that expose together: a frame of each picture from all of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from calib.numerics import Image
from hw.cameras import NamedCamera
from hw.errors import FrameLostError
from hw.rig import Frame, Frames, Projector, exposure_control
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


class CameraGroup:
    """One triggered camera or several, used as a single one. Its frames are tuples, one frame for each of `cameras`.

    All are triggered one right after the other. The exposure of the group begins with the first and ends with the last.
    """

    def __init__(self, cameras: Sequence[TriggeredCamera]) -> None:
        self.cameras = tuple(cameras)
        self.triggered_s = [0.0] * len(self.cameras)
        """When each was triggered last, in seconds of the monotonic clock."""

    @property
    def name(self) -> str:
        """The names of all, for messages."""
        return " and ".join(camera.name for camera in self.cameras)

    @property
    def has_clock(self) -> bool:
        """Whether the begin of every exposure is known."""
        return all(camera.capabilities.clock for camera in self.cameras)

    @property
    def exposure_s(self) -> float:
        """The longest exposure."""
        return max(camera.exposure_s for camera in self.cameras)

    @property
    def wait_s(self) -> float:
        """The longest time from a trigger to the begin of its exposure; infinite if unknown of one."""
        return max(camera.wait_s for camera in self.cameras)

    @property
    def late_s(self) -> float:
        """From the first trigger to the begin of the last exposure, as far as `TriggeredCamera.late_s` tells it."""
        begun_s = [at_s + camera.late_s for at_s, camera in zip(self.triggered_s, self.cameras, strict=True)]
        return max(begun_s) - min(self.triggered_s)

    def expose_for(self, exposure_us: float) -> None:
        """Set the exposure of all. Raises DeviceError."""
        for camera in self.cameras:
            exposure_control(camera).expose_for(exposure_us)

    def expose(self, meanwhile: Callable[[], None] = nothing) -> float:
        """Expose a frame of each, and wait until all exposures are over. Raises DeviceError.

        Returns the time of the first trigger. `meanwhile` is called during the exposures.
        """
        self._expose_from(0, meanwhile)
        return min(self.triggered_s)

    def _expose_from(self, number: int, meanwhile: Callable[[], None]) -> None:
        """Each camera triggers the next one while it exposes."""
        if number == len(self.cameras):
            meanwhile()
            return
        self.triggered_s[number] = self.cameras[number].expose(lambda: self._expose_from(number + 1, meanwhile))

    def collect(self) -> Frames:
        """The last exposed frames. Raises DeviceError, or FrameLostError of the first camera that lost its frame."""
        frames, lost = list[Frame](), list[FrameLostError]()
        for camera in self.cameras:
            try:
                frames.append(camera.collect())
            except FrameLostError as error:
                error.camera = camera.name
                lost.append(error)
        if lost:
            raise lost[0]
        return tuple(frames)

    def grab(self) -> Frames:
        """Expose and collect."""
        self.expose()
        return self.collect()
