"""What is known of cameras before they are opened, and what every backend offers."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from hw.errors import DeviceError
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


_STEPS = 0.01  # cameras round
_ADVICE = "Change the configuration to what the camera can do."


def differs(wanted: float, found: float, tolerance: float = _STEPS) -> bool:
    """Whether a number is another one, beyond the camera's steps."""
    return abs(found - wanted) > tolerance * abs(wanted)


def refuse_other_setting(
    name: str,
    what: str,
    wanted: float | str,
    found: float | str | None,
    tolerance: float = _STEPS,
    advice: str = _ADVICE,
) -> None:
    """Raise DeviceError if the camera made something else of a setting."""
    if isinstance(wanted, str) or isinstance(found, str) or found is None:
        same, told, made = wanted == found, repr(wanted), repr(found)
    else:
        same, told, made = not differs(wanted, found, tolerance), f"{wanted:g}", f"{found:g}"
    if not same:
        raise DeviceError(f"camera {name}: wanted {told} as {what}, but the camera made it {made}. {advice}")


def refuse_other_size(name: str, expected: tuple[int, int], found: tuple[int, int]) -> None:
    """Raise DeviceError if frames have another (width, height) than the configuration says."""
    if found != expected:
        raise DeviceError(
            f"camera {name}: expected frames of {expected[0]} × {expected[1]}, but it delivers {found[0]} × "
            f"{found[1]}. Set the configuration's camera: {{width: {found[0]}, height: {found[1]}}}, or the camera's "
            "own size, then rerun."
        )


def not_found(problem: str, there: Sequence[str]) -> str:
    """What to tell an operator whose camera was not found, but these were."""
    return (
        f"camera: {problem}. Found: {'; '.join(there) or 'none'}. Check power and cable, that the computer's "
        "network interface is in the camera's subnet, that no firewall is in between, and which camera the rig names; "
        "scan devices lists what answers."
    )
