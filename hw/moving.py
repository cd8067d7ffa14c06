"""Moving the rig between captures: a simulated rig moves by itself, any other is moved by a person."""

from hw.backends import RigSettings
from hw.errors import DeviceError
from hw.settings import SimulatedRigSettings


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
