"""Interfaces of camera drivers, and checks of what a camera made of its settings."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

from hw.errors import DeviceError
from hw.rig import Camera


@dataclass(frozen=True)
class CameraInfo:
    """A camera, or a screen, that was found: its name and a description.

    `rig`: lines for a configuration's section `rig` that select it, empty if it cannot be used now. `size`: (width,
    height) of its images, None if unknown.
    """

    name: str
    about: str
    rig: tuple[str, ...] = ()
    size: tuple[int, int] | None = None


class NamedCamera(Camera, Protocol):
    """A real camera. `name` is used in error messages."""

    name: str


class OpenedCamera(NamedCamera, Protocol):
    """A camera opened by a backend. `identity`: device and settings as read back, for the recording's metadata; equal
    whenever it is opened with the same settings.
    """

    identity: dict[str, str]


class CameraDriver(Protocol):
    """The driver of a backend."""

    def list_cameras(self) -> Sequence[CameraInfo]:
        """All cameras that it finds. Takes seconds. Raises DeviceError if the search fails."""

    def connect(self, settings: Any, size: tuple[int, int], refresh_hz: float) -> AbstractContextManager[OpenedCamera]:
        """Open the camera for frames of `size`, (width, height).

        Exposures are rounded to whole refresh periods of the projector where the camera allows it. Raises DeviceError
        if there is no such camera, or if it does not support the settings.
        """


_STEPS = 0.01  # cameras round
_ADVICE = "Change the configuration to what the camera can do."


def differs(wanted: float, actual: float, tolerance: float = _STEPS) -> bool:
    """Whether two values differ by more than the camera's rounding."""
    return abs(actual - wanted) > tolerance * abs(wanted)


def refuse_other_setting(
    name: str,
    what: str,
    wanted: float | str,
    actual: float | str | None,
    tolerance: float = _STEPS,
    advice: str = _ADVICE,
) -> None:
    """Raise DeviceError if the camera did not accept a setting as it was given."""
    if isinstance(wanted, str) or isinstance(actual, str) or actual is None:
        same, given, reported = wanted == actual, repr(wanted), repr(actual)
    else:
        same, given, reported = not differs(wanted, actual, tolerance), f"{wanted:g}", f"{actual:g}"
    if not same:
        raise DeviceError(f"camera {name}: {what} was set to {given}, but reads back as {reported}. {advice}")


def refuse_other_size(name: str, expected: tuple[int, int], size: tuple[int, int]) -> None:
    """Raise DeviceError if the (width, height) of frames is not the configured one."""
    if size != expected:
        raise DeviceError(
            f"camera {name}: expected frames of {expected[0]} × {expected[1]}, but it delivers {size[0]} × "
            f"{size[1]}. Set the configuration's camera: {{width: {size[0]}, height: {size[1]}}}, or the camera's "
            "own size, then rerun."
        )


def not_found(problem: str, there: Sequence[str]) -> str:
    """The message for a camera that was not found; `there` lists those that were."""
    return (
        f"camera: {problem}. Found: {'; '.join(there) or 'none'}. Check power and cable, that the computer's "
        "network interface is in the camera's subnet, that no firewall is in between, and which camera the rig names; "
        "scan devices lists what answers."
    )
