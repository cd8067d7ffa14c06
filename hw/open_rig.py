"""From settings to devices that work."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import ModuleType

from calib.geometry import Calibration, Motion
from hw.errors import DeviceError
from hw.optional_parts import RIG
from hw.projector.process import ScreenProjector
from hw.rig import Rig
from hw.settings import AravisRigSettings, RigSettings, SimulatedRigSettings
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.simulation import SimulatedRoom
from hw.timing.exposures import whole_periods
from hw.timing.synchronisation import synchronised

# Where a screen does not know its rate, and nobody has said it.
_USUAL_REFRESH_HZ = 60.0


@dataclass(frozen=True)
class OpenedRig:
    """A rig, and apart from it what only a simulated one tells, in metres: the true calibration, and its true place,
    X_world = rotation X_camera + translation.
    """

    rig: Rig
    truth: Calibration | None
    place: Motion | None = None


@contextmanager
def open_rig(
    settings: RigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> Iterator[OpenedRig]:
    """Open the devices for as long as the context lasts; sizes are (width, height) in pixels. Raises DeviceError."""
    match settings:
        case SimulatedRigSettings():
            yield _simulated(settings, camera_size, projector_size)
        case AravisRigSettings():
            with ExitStack() as devices:
                yield OpenedRig(_real(settings, camera_size, projector_size, devices), None)


def _simulated(
    settings: SimulatedRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> OpenedRig:
    room = SimulatedRoom(settings, camera_size, projector_size)
    projector = SimulatedProjector(room)
    identity = {"backend": "simulated", "seed": str(settings.seed), "pose": str(settings.pose)}
    rig = Rig(projector, SimulatedCamera(room, projector), identity, settings.refresh_hz)
    return OpenedRig(rig, room.calibration, room.place)


def _real(
    settings: AravisRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int], devices: ExitStack
) -> Rig:
    aravis = import_aravis()
    projector = devices.enter_context(ScreenProjector(settings.screen, projector_size))
    refresh_hz = settings.refresh_hz or projector.screen.refresh_hz or _USUAL_REFRESH_HZ
    exposure_us, periods = whole_periods(settings.exposure_us, refresh_hz)
    camera = devices.enter_context(aravis.AravisCamera(settings, camera_size, exposure_us, refresh_hz))
    known = settings.refresh_hz or projector.screen.refresh_hz
    identity = {
        "backend": "aravis",
        **camera.identity,
        "projector": str(projector.screen),
        "renderer": projector.renderer,
        "refresh": f"{refresh_hz:.5g} Hz{'' if known else ' (assumed: neither screen nor configuration says)'}",
        "exposure in refresh periods": str(periods),
    }
    rig = synchronised(projector, camera, identity, refresh_hz)
    devices.callback(rig.stop)
    return rig


def import_aravis() -> ModuleType:
    """The module `hw.aravis.camera`. Raises DeviceError, naming what to install, if what it needs is not there."""
    try:
        from hw.aravis import camera  # only now, for most users have no Aravis
    except (ImportError, ValueError) as error:  # ValueError: gi is there, Aravis is not
        raise DeviceError(RIG.missing("a GenICam camera", "Aravis with PyGObject")) from error
    return camera
