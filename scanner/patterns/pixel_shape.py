"""Projectors whose pixels are not square: what they show, told in square pixels of another number.

A picture is the same whether its columns are pixels twice as wide as high, or two square pixels each. Calibration takes
pixels for square, so that it is given the latter: longer cells and periods on a projector of more pixels.
"""

from collections.abc import Sequence
from dataclasses import replace

from calib.geometry import PixelGrid, Size
from scanner.patterns.pattern import Axis, Gray, Pattern, Phase, Xor


def in_square_pixels(
    patterns: Sequence[Pattern], size: tuple[int, int], grid: PixelGrid
) -> tuple[tuple[Pattern, ...], Size]:
    """Patterns and size (width, height) in square pixels, of those in the pixels of a grid."""
    across, down = grid.square_per_pixel
    times: dict[Axis, float] = {"x": across, "y": down}
    return tuple(_stretched(p, times) for p in patterns), grid.square_size(size)


def _stretched(pattern: Pattern, times: dict[Axis, float]) -> Pattern:
    match pattern:
        case Gray() | Xor():
            factor = times[pattern.axis]
            return replace(pattern, cell=_plain(pattern.cell * factor), offset=_plain(pattern.offset * factor))
        case Phase():
            # A pixel u is (u + 1/2) times − 1/2: pictures begin at the edge of their first pixel.
            factor = times[pattern.axis]
            shift = pattern.shift + (1 / factor - 1) / (2 * pattern.period)
            return replace(pattern, period=pattern.period * factor, shift=shift)
    return pattern


def _plain(length: float) -> float:
    """A length without the fraction of a whole number."""
    return int(length) if length == int(length) else length
