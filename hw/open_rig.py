"""From settings to devices that work."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from calib.calibration import Calibration
from hw.rig import Rig
from hw.settings import RigSettings
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.simulation import SimulatedRoom


@dataclass(frozen=True)
class OpenedRig:
    """A rig, and apart from it the true calibration in metres, which only a simulated rig has."""

    rig: Rig
    truth: Calibration | None


@contextmanager
def open_rig(
    settings: RigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> Iterator[OpenedRig]:
    """Open the devices for as long as the context lasts; sizes are (width, height) in pixels."""
    match settings.backend:
        case "simulated":
            yield _simulated(settings, camera_size, projector_size)


def _simulated(settings: RigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]) -> OpenedRig:
    room = SimulatedRoom(settings, camera_size, projector_size)
    projector = SimulatedProjector(room)
    identity = {"backend": "simulated", "seed": str(settings.seed), "pose": str(settings.pose)}
    return OpenedRig(Rig(projector, SimulatedCamera(room, projector), identity), room.calibration)
