"""Units of length in formats that know only one."""

from scanner.quantities import UNKNOWN_UNIT, metres_per


def in_metres(unit: str, between: str = "from camera to projector") -> tuple[float, list[str]]:
    """Metres per unit of a result, and sentences about it; `between`: the devices of the baseline."""
    if unit == UNKNOWN_UNIT:
        return 1.0, [f"Note: no length is known, so one baseline, {between}, was written as one metre."]
    return metres_per(unit), []
