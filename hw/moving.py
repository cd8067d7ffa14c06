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


def at_place_or_last(settings: RigSettings, step: int) -> RigSettings:
    """As `at_place`; a simulated rig that has no place so far is at its last one."""
    match settings:
        case SimulatedRigSettings():
            step = min(step, settings.places - 1 - settings.pose)
    return at_place(settings, step)


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
