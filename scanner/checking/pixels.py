"""Whether the projector shows each pixel of a picture unchanged, tested with lines of one pixel, which no scaled
picture shows.

Lines of two grey levels a and b, one pixel wide each, send (L(a) + L(b)) / 2 on average if shown unchanged, with L the
projector's response. L is not linear. So the average falls where the lines lose contrast (interpolation by scaling or
keystone correction, crosstalk), and rises where sharpening increases it. The camera only measures the brightness, and
need not resolve the lines.
"""

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.geometry import PixelGrid
from calib.numerics import Floats, grey
from hw.rig import Rig
from scanner.capture import lines_of_light
from scanner.checking.light import Light, settled
from scanner.checking.report import CheckRow
from scanner.checking.response import RAMP_STEPS, Ramp
from scanner.patterns import Axis

_NAME = "pixels"
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
            _NAME,
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
            _NAME,
            Finding(
                CHECKED_PIXELS,
                Severity.WARNING,
                f"{finding}: the projector scales the picture, or its pixels share their light",
                "Send the picture in the projector's own resolution, and turn off keystone correction, digital zoom, "
                "overscan and aspect correction in its menu; move the projector instead.",
            ),
        )
    return CheckRow(_NAME, Finding(CHECKED_PIXELS, Severity.NOTE, finding))


def _level(step: int) -> int:
    return round(_MOST * step / (RAMP_STEPS - 1))


def _contrast(mean: Floats, ramp: Ramp) -> Floats:
    """The contrast, as a factor, at which lines have this mean light (n,)."""
    levels = np.linspace(0, _MOST, len(ramp.light))
    middle, half = (_level(_BRIGHT) + _level(_DARK)) / 2, (_level(_BRIGHT) - _level(_DARK)) / 2
    factor = np.linspace(0.0, middle / half, 200)
    ends = [np.interp(middle + sign * factor * half, levels, ramp.light) for sign in (-1, 1)]
    return np.interp(mean, np.mean(ends, axis=0), factor)
