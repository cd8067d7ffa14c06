"""The projector's response, from a ramp of even grey pictures.

Whether the projector shows each pixel of a picture unchanged, tested with lines of one pixel, which no scaled
picture shows.

Lines of two grey levels a and b, one pixel wide each, send (L(a) + L(b)) / 2 on average if shown unchanged, with L the
projector's response. L is not linear. So the average falls where the lines lose contrast (interpolation by scaling or
keystone correction, crosstalk), and rises where sharpening increases it. The camera only measures the brightness, and
need not resolve the lines.
"""

from dataclasses import dataclass

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import PixelGrid
from calib.numerics import Floats, grey
from hw.rig import Rig
from scanner.capture import lines_of_light
from scanner.checking.light import Light, settled
from scanner.checking.report import CheckRow
from scanner.patterns import Axis, ProjectorResponse

_RESPONSE = "response"
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
_PIXELS = "pixels"
# The two grey levels, as steps of the ramp.
_DARK, _BRIGHT = 4, 11
_MOST = 255.0
# A scaled picture keeps about 55 %; a panel whose pixels share a tenth of their light, 79 %.
_LEAST_CONTRAST, _MOST_CONTRAST = 0.7, 1.2
_AXES: tuple[Axis, Axis] = ("x", "y")

CHECKED_PIXELS = FindingKind(
    "check-pixels",
    "What scan check says of whether the projector shows single pixels unchanged.",
    "Show the picture in the projector's own resolution, without keystone correction and zoom.",
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
            _RESPONSE,
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
            _RESPONSE,
            Finding(
                CHECKED_RESPONSE,
                Severity.WARNING,
                f"{finding}; the brightest levels are alike",
                "Lower its contrast setting.",
            ),
        )
    return CheckRow(_RESPONSE, Finding(CHECKED_RESPONSE, Severity.NOTE, finding))


def pixel_row(rig: Rig, grid: PixelGrid, light: Light, ramp: Ramp) -> CheckRow | None:
    """The remaining contrast of lines of the grid's pixels; None if the response is too linear. Raises DeviceError."""
    if ramp.response is None:
        return None
    where = light.well_lit
    black, white = light.mean_black[where].mean(), light.mean_white[where].mean()
    # Ghosting that is harmless elsewhere would change the contrast here by percents.
    levels = _level(_DARK), _level(_BRIGHT)
    size = grid.device_size(rig.projector.size)
    frames = settled(rig.photograph, [grid.spread(lines_of_light(axis, size, levels)) for axis in _AXES])
    mean = np.array([(grey(frame.image)[where].mean() - black) / (white - black) for frame in frames])
    return row_of(_contrast(mean, ramp))


def row_of(contrast: Floats) -> CheckRow:
    """The row for the remaining contrast of lines along x and y, (2,)."""
    x, y = (f"{100 * value:.0f} %" for value in contrast)
    finding = f"lines of one pixel keep {x} of their contrast along x, {y} along y"
    if contrast.max() > _MOST_CONTRAST:
        return CheckRow(
            _PIXELS,
            Finding(
                CHECKED_PIXELS,
                Severity.WARNING,
                f"{finding}: the projector sharpens, or the camera's response is not linear",
                "Turn sharpness in the projector's menu to 0 or its neutral value, and detail or edge enhancement off; "
                "set the camera's gamma to 1.",
            ),
        )
    if contrast.min() < _LEAST_CONTRAST:
        return CheckRow(
            _PIXELS,
            Finding(
                CHECKED_PIXELS,
                Severity.WARNING,
                f"{finding}: the projector scales the picture, or its pixels share their light",
                "Send the picture in the projector's own resolution, and turn off keystone correction, digital zoom, "
                "overscan and aspect correction in its menu; move the projector instead.",
            ),
        )
    return CheckRow(_PIXELS, Finding(CHECKED_PIXELS, Severity.NOTE, finding))


def _level(step: int) -> int:
    return round(_MOST * step / (RAMP_STEPS - 1))


def _contrast(mean: Floats, ramp: Ramp) -> Floats:
    """The contrast, as a factor, at which lines have this mean light (n,)."""
    levels = np.linspace(0, _MOST, len(ramp.light))
    middle, half = (_level(_BRIGHT) + _level(_DARK)) / 2, (_level(_BRIGHT) - _level(_DARK)) / 2
    factor = np.linspace(0.0, middle / half, 200)
    ends = [np.interp(middle + sign * factor * half, levels, ramp.light) for sign in (-1, 1)]
    return np.interp(mean, np.mean(ends, axis=0), factor)
