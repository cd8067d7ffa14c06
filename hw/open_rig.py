"""Opens the devices of a configuration, and moves the rig between captures.

A simulated rig moves by itself, any other is moved by a person.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from calib.geometry import SQUARE_PIXELS, Calibration, PixelGrid, Pose
from hw.backends import RigSettings
from hw.errors import DeviceError
from hw.real_devices import Pair, PairSettings, RealDevices
from hw.rig import Rig
from hw.settings import CameraRigSettings, SimulatedRigSettings

if TYPE_CHECKING:
    from hw.simulated import Scenery
    from hw.simulated.things import Solid


@dataclass(frozen=True)
class OpenedRig:
    """A rig, and the ground truth of a simulated one in metres."""

    rig: Rig
    truth: Calibration | None
    """Its calibration."""
    place: Pose | None = None
    """Its pose: X_world = rotation X_camera + translation."""
    thing: "Solid | None" = None
    """With one, the world's frame is the thing's."""
    others: tuple["OpenedRig", ...] = ()
    """Of the rig's others."""

    @property
    def all(self) -> tuple["OpenedRig", ...]:
        """That of each camera, this one first."""
        return (self, *self.others)


@contextmanager
def open_rig(
    settings: RigSettings,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    grid: PixelGrid = SQUARE_PIXELS,
) -> Iterator[OpenedRig]:
    """Open the devices for as long as the context lasts. Raises DeviceError.

    Sizes are (width, height) in pixels, square ones of a projector whose own form a `grid`.
    """
    pair = ("camera", "projector")
    with (
        open_network({pair: PairSettings(settings, camera_size, projector_size, grid)}) as network,
        network.rig("projector", ["camera"]) as opened,
    ):
        yield opened


class OpenedNetwork:
    """Cameras and projectors of which any pair is a rig."""

    def __init__(self, pairs: Mapping[Pair, PairSettings[RigSettings]], real: RealDevices) -> None:
        self._pairs = pairs
        self._real = real

    def together(self, projector: str) -> list[list[str]]:
        """The cameras in a projector's light, in groups whose cameras can take frames of the same picture."""
        simulated = [
            camera
            for (camera, further), pair in self._pairs.items()
            if further == projector and isinstance(pair.rig, SimulatedRigSettings)
        ]
        return [simulated] if simulated else self._real.together(projector)

    @contextmanager
    def rig(self, projector: str, cameras: Sequence[str]) -> Iterator[OpenedRig]:
        """Prepare a projector and cameras of one group, while all other projectors are dark. Raises DeviceError."""
        simulated = [
            _simulated(pair.rig, pair.camera_size, pair.projector_size, pair.grid)
            for pair in (self._pairs[camera, projector] for camera in cameras)
            if isinstance(pair.rig, SimulatedRigSettings)
        ]
        if simulated:
            first, *further = simulated
            rig = replace(first.rig, others=tuple(simulation.rig for simulation in further))
            yield replace(first, rig=rig, others=tuple(further))
            return
        with self._real.rig(projector, cameras) as rig:
            yield OpenedRig(rig, None, others=tuple(OpenedRig(further, None) for further in rig.others))


@contextmanager
def open_network(pairs: Mapping[Pair, PairSettings[RigSettings]]) -> Iterator[OpenedNetwork]:
    """Open all devices of some pairs, named by camera and projector, for as long as the context lasts.

    Raises DeviceError.
    """
    real = {
        names: PairSettings(pair.rig, pair.camera_size, pair.projector_size, pair.grid)
        for names, pair in pairs.items()
        if isinstance(pair.rig, CameraRigSettings)
    }
    with RealDevices(real) as devices:
        yield OpenedNetwork(pairs, devices)


def _simulated(
    settings: SimulatedRigSettings, camera_size: tuple[int, int], projector_size: tuple[int, int], grid: PixelGrid
) -> OpenedRig:
    from hw.simulated import SimulatedRoom  # draws, which real devices need not
    from hw.simulated.things import SimulatedThing

    true_size = settings.grid.square_size(grid.device_size(projector_size))
    if settings.thing.kind != "none":
        thing = SimulatedThing(settings, camera_size, true_size)
        return OpenedRig(_rig_before(thing, grid), thing.calibration, thing.truth.place, thing.solid)
    room = SimulatedRoom(settings, camera_size, true_size)
    return OpenedRig(_rig_before(room, grid), room.calibration, room.place)


def _rig_before(room: "Scenery", grid: PixelGrid) -> Rig:
    from hw.simulated import SimulatedCamera, SimulatedProjector

    settings, projector = room.settings, SimulatedProjector(room, grid)
    identity = {"backend": "simulated", "seed": str(settings.seed), "pose": str(settings.pose)}
    return Rig(projector, SimulatedCamera(room, projector), identity, settings.refresh_hz)


def moves_by_itself(settings: RigSettings) -> bool:
    """Whether the rig needs nobody to move it between captures."""
    return settings.backend == "simulated"


def turns_by_itself(settings: RigSettings) -> bool:
    """Whether the next place turns a simulated thing instead of moving the rig."""
    return isinstance(settings, SimulatedRigSettings) and settings.thing.kind != "none"


def at_place_or_last(settings: RigSettings, step: int) -> RigSettings:
    """As `at_place`, but a simulated rig stops at its last place."""
    if isinstance(settings, SimulatedRigSettings):
        step = min(step, settings.places - 1 - settings.pose)
    return at_place(settings, step)


def at_place(settings: RigSettings, step: int) -> RigSettings:
    """The settings of a simulated rig, `step` places after the configured one; other rigs are returned unchanged.

    Raises DeviceError if a simulated rig has no such place.
    """
    if not isinstance(settings, SimulatedRigSettings):
        return settings
    last = settings.places - 1
    if settings.pose + step > last:
        raise DeviceError(
            f"the simulated rig has poses 0 to {last}; from pose {settings.pose} it cannot move {step} times"
        )
    return settings.model_copy(update={"pose": settings.pose + step})
