"""Rigs that can move: the simulated one steps aside by itself, any other is moved by a person."""

from hw.backends import RigSettings
from hw.errors import DeviceError
from hw.settings import SimulatedRigSettings


def moves_by_itself(settings: RigSettings) -> bool:
    """Whether the rig needs nobody to move it between captures."""
    return settings.backend == "simulated"


def turns_by_itself(settings: RigSettings) -> bool:
    """Whether a thing stands before the rig that is turned where the rig is asked to go to another place."""
    return isinstance(settings, SimulatedRigSettings) and settings.thing.kind != "none"


def turned_by_itself(settings: RigSettings, times: int) -> RigSettings:
    """The same rig before its thing, turned so often, or as often as it can be; one that a person turns is as it is."""
    match settings:
        case SimulatedRigSettings() if turns_by_itself(settings):
            return at_place(settings, min(times, settings.places - 1 - settings.pose))
    return settings


def at_place(settings: RigSettings, step: int) -> RigSettings:
    """The same rig at its place number `step` after the configured one; a rig that a person moves is always there.

    Raises DeviceError if a simulated rig has no such place.
    """
    match settings:
        case SimulatedRigSettings():
            last = settings.places - 1
            if settings.pose + step > last:
                raise DeviceError(
                    f"the simulated rig has places 0 to {last}; from pose {settings.pose} it cannot step aside "
                    f"{step} times"
                )
            settings = settings.model_copy(update={"pose": settings.pose + step})
    return settings
