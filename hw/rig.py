"""The two interfaces that every rig implements, real or simulated, and nothing about patterns."""

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


class Projector(Protocol):
    """Something that throws images onto the scene."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    def show(self, image: Image) -> None:
        """Put an (H, W) 8-bit grey image on the scene; returns once it is there.

        Raises ValueError if the image has another size, DeviceError if the device fails.
        """


@dataclass(frozen=True)
class Capabilities:
    """What a camera can do, by which everything above it is chosen.

    `streaming`: frames come by themselves, one after the other; else each is taken when it is asked for. `exposure`:
    whether it can be set while the camera is open, can only be read, or is not known at all. `clock`: whether it is
    known when an exposure began, by time stamps or because the camera obeys at once.
    """

    streaming: bool = False
    exposure: Literal["settable", "readable", "unknown"] = "unknown"
    clock: bool = False


class Camera(Protocol):
    """Something that takes images of the scene."""

    @property
    def capabilities(self) -> Capabilities:
        """What it can do; the same as long as it is open."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    @property
    def highest_level(self) -> int:
        """The largest number that a pixel can have."""

    def grab(self) -> Frame:
        """Expose and return one frame of what the projector shows now. Raises DeviceError if the device fails."""


class ExposureControl(Protocol):
    """What a camera also has if its exposure is settable."""

    @property
    def exposure_us(self) -> float:
        """The exposure of all frames from now on, in microseconds."""

    @property
    def exposure_limits_us(self) -> tuple[float, float]:
        """The shortest and the longest exposure that the camera can make."""

    def expose_for(self, exposure_us: float) -> float:
        """Expose all frames from now on so long; returns what it came to, for a camera may round.

        Raises DeviceError if the camera cannot.
        """


@dataclass(frozen=True)
class Rig:
    """A projector and a camera that do not move against each other.

    `identity` names the devices, with their settings as read back, for the recording's metadata. `refresh_hz`: how many
    pictures the projector builds up in a second; exposures should last for whole ones. None if that does not matter.
    """

    projector: Projector
    camera: Camera
    identity: dict[str, str] = field(default_factory=dict)
    refresh_hz: float | None = None

    def photograph(
        self,
        images: Iterable[Image],
        exposures_us: Sequence[float] = (),
        # Of devices that wait for each other nothing has to be proven.
        level: Sequence[Sequence[int]] = (),  # noqa: ARG002
        unpaired: Sequence[Sequence[int]] = (),  # noqa: ARG002
    ) -> Iterator[Frame]:
        """Show images one after the other, and yield a frame of each; the frame is taken when it is asked for.

        `level`: the numbers of images that together light every place alike. `unpaired`: those of black and white
        images of which none is an exclusive or of others, in groups of at least two. Rigs of real devices are faster
        where they can tell from these that every frame is of its own image.

        `exposures_us` take turns; without any, the camera's exposure stays as it is. Raises what the devices raise, and
        DeviceError if there are exposures that the camera cannot change to.
        """
        for image, exposure_us in zip(images, cycle(exposures_us or (None,)), strict=False):
            if exposure_us is not None:
                exposure_control(self.camera).expose_for(exposure_us)
            self.projector.show(image)
            yield self.camera.grab()

    def account(self) -> Mapping[str, object]:
        """What is worth recording of the frames taken so far, beside the frames themselves."""
        return {}


def settable_exposure(camera: Camera) -> ExposureControl | None:
    """The camera, if its exposure can be changed."""
    return cast(ExposureControl, camera) if camera.capabilities.exposure == "settable" else None


def exposure_control(camera: Camera) -> ExposureControl:
    """The camera, whose exposure can be changed. Raises DeviceError if it cannot."""
    control = settable_exposure(camera)
    if control is None:
        raise DeviceError(
            "this camera's exposure cannot be changed during a capture; take every pattern with one exposure"
        )
    return control
