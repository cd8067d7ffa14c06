"""What is known of cameras before they are opened, and what every backend offers."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from hw.rig import Camera


@dataclass(frozen=True)
class CameraInfo:
    """A camera that was found: `name`, and what it can do as far as it would tell.

    `rig`: the lines of a configuration's section `rig` that choose it, none if it cannot be used now; `size` is the
    (width, height) of its images, None if it is not known.
    """

    name: str
    about: str
    rig: tuple[str, ...] = ()
    size: tuple[int, int] | None = None


class NamedCamera(Camera, Protocol):
    """A camera of a rig of real devices: `name` is what errors call it."""

    name: str


class OpenedCamera(NamedCamera, Protocol):
    """The same as a backend opens it. `identity`: the device and its settings as read back, for recordings; the same
    whenever it is opened with these settings.
    """

    identity: dict[str, str]


class CameraDriver(Protocol):
    """What a backend offers when what it needs is installed."""

    def list_cameras(self) -> Sequence[CameraInfo]:
        """All cameras that it finds. Takes seconds. Raises DeviceError if it cannot look for any."""

    def connect(self, settings: Any, size: tuple[int, int], refresh_hz: float) -> AbstractContextManager[OpenedCamera]:
        """Open the camera of the backend's settings for frames of (width, height).

        Exposures are whole refresh periods of the projector as far as the camera can make them. Raises DeviceError if
        there is no such camera, or it cannot be used so.
        """


def not_found(problem: str, there: Sequence[str]) -> str:
    """What to tell an operator whose camera was not found, but these were."""
    return (
        f"camera: {problem}. Found: {'; '.join(there) or 'none'}. Check power and cable, that the computer's "
        "network interface is in the camera's subnet, that no firewall is in between, and which camera the rig names; "
        "scan devices lists what answers."
    )
