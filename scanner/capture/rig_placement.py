"""Move the rig between captures, automatically or by the operator."""

from hw.backends import RigSettings
from hw.errors import DeviceError
from hw.open_rig import at_place, moves_by_itself
from scanner.errors import InputError
from scanner.ui import Operator


def check_places(
    settings: RigSettings,
    number: int,
    operator: Operator,
    *,
    option: str = "--captures",
    joined: str = "scan calibrate",
) -> None:
    """Raise InputError if the rig cannot go to so many places, or nobody could be asked to move it.

    `option`: which asked for that `number`. `joined`: the command that puts results together.
    """
    if number > 1 and not moves_by_itself(settings) and not operator.can_ask:
        raise InputError(
            f"{option} {number} asks you to move the rig between {option[2:]}, but the input is no terminal: run it in "
            f"one, or scan several times and put the results together with {joined}"
        )
    try:
        at_place(settings, number - 1)
    except DeviceError as error:
        raise InputError(f"{option} {number}: {error}") from error


def next_place(
    settings: RigSettings, step: int, number: int, operator: Operator, *, enough: bool = False
) -> RigSettings | None:
    """Return the rig, placed for capture `step` of `number`; None if the operator ends the scan.

    `enough`: a further capture is not needed.
    """
    if step and not moves_by_itself(settings):
        if_wanted = ", if you want one more" if enough else ""
        if not operator.ready(
            f"Capture {step} of {number} is done. Move the rig as a whole, so that it sees the same corner from "
            f"another side{if_wanted}"
        ):
            return None
    return at_place(settings, step)
