"""The projector's response, from a ramp of even grey pictures."""

from dataclasses import dataclass

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats, grey
from hw.rig import Rig
from scanner.checking.light import Light, settled
from scanner.checking.report import CheckRow
from scanner.patterns import ProjectorResponse

_NAME = "response"
# 255 = 15 × 17: whole grey levels, enough for a smooth curve.
RAMP_STEPS = 16
# Averages over thousands of pixels are precise; levels that differ by less are equal.
_LEAST_RISE = 1e-4
# Share of white: a last step that adds less light is wasted.
_FLAT = 0.005

CHECKED_RESPONSE = FindingKind(
    "check-response",
    "What scan check says of the light of the projector's grey levels.",
    "Switch picture modes and contrast enhancement off in the projector's menu.",
)


@dataclass(frozen=True)
class Ramp:
    """Mean brightness of even pictures at equally spaced grey levels 0 … 255, from 0 for the first to 1 for the last.

    `response`: None if the light does not rise from level to level.
    """

    light: Floats
    response: ProjectorResponse | None


def measure_ramp(rig: Rig, light: Light) -> Ramp | None:
    """Photograph the ramp, and average where the projector's light falls; None if nowhere. Raises DeviceError."""
    width, height = rig.projector.size
    where = light.well_lit
    if not where.any():
        return None
    pictures = [np.full((height, width), round(level), np.uint8) for level in np.linspace(0, 255, RAMP_STEPS)]
    frames = settled(rig.photograph, pictures, light)
    levels = np.array([grey(frame.image)[where].mean() for frame in frames])
    return ramp_of((levels - levels[0]) / (levels[-1] - levels[0]))


def ramp_of(relative: Floats) -> Ramp:
    """Return the ramp from the brightness (n,) relative to black and white."""
    if np.any(np.diff(relative) < _LEAST_RISE):
        return Ramp(relative, None)
    return Ramp(relative, ProjectorResponse((0.0, *(float(value) for value in relative[1:-1]), 1.0)))


def response_row(ramp: Ramp) -> CheckRow:
    """Gamma, and defects of the curve."""
    steps = np.diff(ramp.light)
    if ramp.response is None:
        first = round(255 * int(np.argmin(steps)) / (len(ramp.light) - 1))
        return CheckRow(
            _NAME,
            Finding(
                CHECKED_RESPONSE,
                Severity.WARNING,
                f"above grey level {first} it becomes no brighter",
                "Set the projector's picture mode to standard, and turn off dynamic contrast and colour enhancement; "
                "lower its contrast if bright levels are alike, raise its brightness if dark ones are.",
            ),
        )
    response = ramp.response
    finding = f"gamma {response.gamma:.2f}"
    if response.off_power_law > _FLAT:
        finding += f", with up to {100 * response.off_power_law:.1f} % of white off a power law"
    if steps[-1] < _FLAT:
        return CheckRow(
            _NAME,
            Finding(
                CHECKED_RESPONSE,
                Severity.WARNING,
                f"{finding}; the brightest levels are alike",
                "Lower its contrast setting.",
            ),
        )
    return CheckRow(_NAME, Finding(CHECKED_RESPONSE, Severity.NOTE, finding))
