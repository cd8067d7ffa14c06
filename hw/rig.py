"""The interfaces of projectors, cameras and rigs, real or simulated. They know nothing of patterns."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from typing import Literal, Protocol, cast

from calib.numerics import Image
from hw.errors import DeviceError


@dataclass(frozen=True)
class Frame:
    """One camera image, (H, W) grey or (H, W, 3) in OpenCV's channel order (BGR), 8 or 16 bit."""

    image: Image
    exposure_us: float | None = None
    timestamp_ns: int | None = None


Frames = tuple[Frame, ...]  # one of each camera


@dataclass(frozen=True)
class Redundancy:
    """What verifies the frames of a series of images, by groups of image numbers; without any, nothing does.

    `level`: the images of a group sum to uniform light. `unpaired`: two or more binary images, of which none is an
    exclusive or of others.
    """

    level: Sequence[Sequence[int]] = ()
    unpaired: Sequence[Sequence[int]] = ()

    def __bool__(self) -> bool:
        return bool(self.level or self.unpaired)


NO_REDUNDANCY = Redundancy()


class Projector(Protocol):
    """A device that projects images onto the scene."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    def show(self, image: Image) -> None:
        """Project an (H, W) 8-bit grey image; returns once it is visible.

        Raises ValueError if the image has another size, DeviceError if the device fails.
        """


@dataclass(frozen=True)
class Capabilities:
    """What a camera can do; the kind of acquisition follows from it."""

    streaming: bool = False
    """Frames arrive continuously; otherwise each is triggered."""
    exposure: Literal["settable", "readable", "unknown"] = "unknown"
    """It can be set while the camera is open, can only be read, or is unknown."""
    clock: bool = False
    """The begin of an exposure is known, from time stamps or because the trigger acts at once."""


class Camera(Protocol):
    """A device that takes images of the scene."""

    @property
    def capabilities(self) -> Capabilities:
        """Its capabilities, constant while it is open."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    @property
    def highest_level(self) -> int:
        """The largest pixel value."""

    def grab(self) -> Frame:
        """Expose and return one frame of the current scene. Raises DeviceError if the device fails."""


class ExposureControl(Protocol):
    """The additional interface of cameras whose exposure is settable."""

    @property
    def exposure_us(self) -> float:
        """The exposure of all frames from now on, in microseconds."""

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """The shortest and the longest exposure of the camera, in microseconds."""

    def expose_for(self, exposure_us: float) -> float:
        """Set the exposure of all frames from now on; returns the exposure as the camera rounded it.

        Raises DeviceError if the camera does not support it.
        """


@dataclass(eq=False)
class Rig:
    """A projector and a camera, fixed relative to each other."""

    projector: Projector
    camera: Camera
    identity: dict[str, str] = field(default_factory=dict)
    """Names of the devices, with their settings as read back, for the recording's metadata."""
    refresh_hz: float | None = None
    """The projector's refresh rate; exposures should be whole periods. None if that does not matter."""
    others: tuple["Rig", ...] = ()
    """Rigs of further cameras in its light."""

    @property
    def all(self) -> tuple["Rig", ...]:
        """The rig of each camera, this one first."""
        return (self, *self.others)

    def photograph(
        self, images: Iterable[Image], exposures_us: Sequence[float] = (), redundancy: Redundancy = NO_REDUNDANCY
    ) -> Iterator[Frame]:
        """As `photograph_together`; yields the frames of the first camera."""
        return (frames[0] for frames in self.photograph_together(images, exposures_us, redundancy))

    def photograph_together(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float] = (),
        redundancy: Redundancy = NO_REDUNDANCY,  # noqa: ARG002  devices that wait for each other need no verification
    ) -> Iterator[Frames]:
        """Show images one after the other, and yield a frame of each by each camera, in the order of `all`; they are
        taken on request.

        Rigs of real devices use the `redundancy` of the images to verify frames, which allows pipelined acquisition.

        `exposures_us` are used cyclically; without any, the exposure is left unchanged. Raises what the devices
        raise, and DeviceError if a camera's exposure cannot be changed.
        """
        for image, exposure_us in zip(images, cycle(exposures_us or (None,)), strict=False):
            yield tuple(rig._photograph_one(image, exposure_us) for rig in self.all)

    def _photograph_one(self, image: Image, exposure_us: float | None) -> Frame:
        if exposure_us is not None:
            exposure_control(self.camera).expose_for(exposure_us)
        self.projector.show(image)
        return self.camera.grab()

    def account(self) -> Mapping[str, object]:
        """Metadata of the frames taken so far, for the recording."""
        return {}


def settable_exposure(camera: Camera) -> ExposureControl | None:
    """The camera, if its exposure can be changed; otherwise None."""
    return cast(ExposureControl, camera) if camera.capabilities.exposure == "settable" else None


def exposure_control(camera: Camera) -> ExposureControl:
    """The camera, to change its exposure. Raises DeviceError if that is not possible."""
    control = settable_exposure(camera)
    if control is None:
        raise DeviceError(
            "this camera's exposure cannot be changed during a capture; take every pattern with one exposure"
        )
    return control
