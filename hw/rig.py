"""The two interfaces that every rig implements, real or simulated, and nothing about patterns."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from calib.arrays import Image


@dataclass(frozen=True)
class Frame:
    """One camera image, (H, W) grey or (H, W, 3) in OpenCV's channel order (BGR), 8 or 16 bit."""

    image: Image
    exposure_us: float | None = None
    timestamp_ns: int | None = None


class Projector(Protocol):
    """Something that throws images onto the scene."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    def show(self, image: Image) -> None:
        """Put an (H, W) 8-bit grey image on the scene; returns once it is there.

        Raises ValueError if the image has another size, DeviceError if the device fails.
        """


class Camera(Protocol):
    """Something that takes images of the scene."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    def grab(self) -> Frame:
        """Expose and return one frame of what the projector shows now. Raises DeviceError if the device fails."""


@runtime_checkable
class ExposureControl(Protocol):
    """What a camera also has if its exposure can be changed between frames."""

    def expose_for(self, exposure_us: float) -> None:
        """Expose all frames from now on so long. Raises DeviceError if the camera cannot."""


@dataclass(frozen=True)
class Rig:
    """A projector and a camera that do not move against each other.

    `identity` names the devices, with their settings as read back, for the recording's metadata.
    """

    projector: Projector
    camera: Camera
    identity: dict[str, str] = field(default_factory=dict)

    def photograph(self, images: Iterable[Image]) -> Iterator[Frame]:
        """Show images one after the other, and yield a frame of each; the frame is taken when it is asked for.

        Raises what the devices raise.
        """
        for image in images:
            self.projector.show(image)
            yield self.camera.grab()

    def account(self) -> Mapping[str, object]:
        """What is worth recording of the frames taken so far, beside the frames themselves."""
        return {}
