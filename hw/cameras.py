"""What is known of cameras before they are opened."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class CameraInfo:
    """A camera that was found: how it names itself, and what it can do as far as it would tell.

    `sensor_size` is (width, height), None for a camera that somebody else uses.
    """

    device_id: str
    vendor: str
    model: str
    serial: str
    address: str
    sensor_size: tuple[int, int] | None = None
    pixel_formats: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.vendor} {self.model} {self.serial} at {self.address}"


def not_found(problem: str, there: Sequence[CameraInfo]) -> str:
    """What to tell an operator whose camera was not found, but these were."""
    return (
        f"camera: {problem}. Found: {'; '.join(map(str, there)) or 'none'}. Check power and cable, that the computer's "
        "network interface is in the camera's subnet, that no firewall is in between, and which camera the rig names; "
        "scan devices lists what answers."
    )
