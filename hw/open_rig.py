"""Opens the devices of a configuration."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, cast

from calib.geometry import Calibration, Motion
from hw.backends import RigSettings, backend_of
from hw.projector.process import ScreenProjector
from hw.rig import Rig
from hw.settings import CameraRigSettings, SimulatedRigSettings
from hw.simulated.rig import Scenery, SimulatedCamera, SimulatedProjector
from hw.simulated.simulation import SimulatedRoom
from hw.simulated.things import SimulatedThing, Solid
from hw.timing.streamed_rig import streamed
from hw.timing.synchronisation import synchronised
from hw.timing.timed_rig import TimedRig

# If neither screen nor configuration states the rate.
_USUAL_REFRESH_HZ = 60.0


@dataclass(frozen=True)
class OpenedRig:
    """A rig, and the ground truth of a simulated one in metres: its calibration, and its pose `place`, X_world =
    rotation X_camera + translation. With a `thing`, the world's frame is the thing's.
    """

    rig: Rig
    truth: Calibration | None
    place: Motion | None = None
    thing: Solid | None = None


@contextmanager
def open_rig(
    settings: RigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> Iterator[OpenedRig]:
    """Open the devices for as long as the context lasts; sizes are (width, height) in pixels. Raises DeviceError."""
    match settings:
        case SimulatedRigSettings():
            yield _simulated(settings, camera_size, projector_size)
        case CameraRigSettings():
            with ExitStack() as devices:
                yield OpenedRig(_real(settings, camera_size, projector_size, devices), None)


def _simulated(
    settings: SimulatedRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int]
) -> OpenedRig:
    if settings.thing.kind != "none":
        thing = SimulatedThing(settings, camera_size, projector_size)
        return OpenedRig(_rig_before(thing), thing.calibration, thing.truth.place, thing.solid)
    room = SimulatedRoom(settings, camera_size, projector_size)
    return OpenedRig(_rig_before(room), room.calibration, room.place)


def _rig_before(room: Scenery) -> Rig:
    settings, projector = room.settings, SimulatedProjector(room)
    identity = {"backend": "simulated", "seed": str(settings.seed), "pose": str(settings.pose)}
    return Rig(projector, SimulatedCamera(room, projector), identity, settings.refresh_hz)


def _real(
    settings: CameraRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int], devices: ExitStack
) -> Rig:
    driver = backend_of(settings).load()  # first: a missing library is reported before anything is shown
    projector = devices.enter_context(ScreenProjector(settings.screen, projector_size))
    known_hz = settings.refresh_hz or projector.screen.refresh_hz
    refresh_hz = known_hz or _USUAL_REFRESH_HZ
    camera = devices.enter_context(driver.connect(settings, camera_size, refresh_hz))
    identity = {
        "backend": settings.backend,
        **camera.identity,
        "projector": str(projector.screen),
        "renderer": projector.renderer,
        "refresh": f"{refresh_hz:.5g} Hz{'' if known_hz else ' (assumed: neither screen nor configuration says)'}",
    }
    timed = streamed if camera.capabilities.streaming else synchronised
    rig: TimedRig = timed(projector, cast(Any, camera), identity, refresh_hz)
    devices.callback(rig.stop)
    return rig
