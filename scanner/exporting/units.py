"""Units of length in formats that know only one."""

from scanner.quantities import UNKNOWN_UNIT, metres_per


def in_metres(unit: str) -> tuple[float, list[str]]:
    """Metres per unit of a result, and what to tell about it."""
    if unit == UNKNOWN_UNIT:
        return 1.0, ["Note: no length is known, so one baseline, from camera to projector, was written as one metre."]
    return metres_per(unit), []
