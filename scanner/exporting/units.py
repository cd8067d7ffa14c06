"""Units of length in formats that know only one."""

from collections.abc import Iterable

from calib.finding import Finding, FindingKind, Severity
from scanner.quantities import UNKNOWN_UNIT, metres_per

NO_LENGTH = FindingKind(
    "no-length",
    "No length is known, so an export has one baseline as one metre.",
    "Give one length: --set scale.baseline_m=0.4, or a distance that was measured.",
)


def in_metres(unit: str, between: str = "from camera to projector") -> tuple[float, list[Finding]]:
    """Metres per unit of a result, and what is to be said about it; `between`: the devices of the baseline."""
    if unit == UNKNOWN_UNIT:
        message = f"no length is known, so one baseline, {between}, was written as one metre."
        return 1.0, [Finding(NO_LENGTH, Severity.NOTE, message)]
    return metres_per(unit), []


def noted(findings: Iterable[Finding]) -> list[str]:
    """Findings as sentences about an export."""
    return [f"Note: {finding}" for finding in findings]
