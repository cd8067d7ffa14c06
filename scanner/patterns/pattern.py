"""The patterns that are projected, as immutable values; drawing them; the sequence that suits a projector, and the
named ones.

Coordinates are projector pixels, x to the right and y down, pixel centres at integers. What each kind means is a file
format that other programs depend on (see docs/formats.md).

Projectors whose pixels are not square: what they show, told in square pixels of another number.

A picture is the same whether its columns are pixels twice as wide as high, or two square pixels each. Calibration takes
pixels for square, so that it is given the latter: longer cells and periods on a projector of more pixels.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from math import ceil, log2
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.geometry import PixelGrid, Size
from calib.numerics import Floats

Axis = Literal["x", "y"]
Code = Literal["gray", "xor", "both"]
_ROUNDING = 1e-9  # of lengths in cells that are no whole pixels


@dataclass(frozen=True)
class White:
    """Everything lit."""

    def brightness(self, x: Floats, y: Floats) -> Floats:
        """Brightness 0 … 1 at projector coordinates of equal shape."""
        return np.ones(np.broadcast(x, y).shape)


@dataclass(frozen=True)
class Black:
    """The projector's black level."""

    def brightness(self, x: Floats, y: Floats) -> Floats:
        """Brightness 0 … 1 at projector coordinates of equal shape."""
        return np.zeros(np.broadcast(x, y).shape)


@dataclass(frozen=True)
class Gray:
    """One bit of the Gray code of n = floor((coordinate + offset) / cell); bit 0 is the most significant of `bits`."""

    axis: Axis
    bit: int
    bits: int
    cell: float = 1
    offset: float = 0
    inverted: bool = False

    def brightness(self, x: Floats, y: Floats) -> Floats:
        """Brightness 0 … 1 at projector coordinates of equal shape."""
        coordinate = x if self.axis == "x" else y
        n = np.floor((coordinate + self.offset) / self.cell).astype(np.int64)
        bright = ((n ^ (n >> 1)) >> (self.bits - 1 - self.bit)) & 1 == 1
        return np.where(bright != self.inverted, 1.0, 0.0)


@dataclass(frozen=True)
class Xor:
    """One bit of a Gray code, exclusive or its bit `base`: its stripes are as fine as those of that bit.

    Interreflected light averages over fine stripes and adds the same level to all patterns, so that it does not flip a
    bit (Gupta et al., CVPR 2011). The base itself is shown as a bit of the Gray code.
    """

    axis: Axis
    bit: int
    bits: int
    base: int
    cell: float = 1
    offset: float = 0
    inverted: bool = False

    def brightness(self, x: Floats, y: Floats) -> Floats:
        """Brightness 0 … 1 at projector coordinates of equal shape."""
        bit, base = (
            Gray(self.axis, number, self.bits, self.cell, self.offset).brightness(x, y)
            for number in (self.bit, self.base)
        )
        return np.where((bit != base) != self.inverted, 1.0, 0.0)


@dataclass(frozen=True)
class Phase:
    """A fringe: ½ (1 + cos 2π(coordinate / period + shift)), period in pixels, shift in cycles."""

    axis: Axis
    period: float
    shift: float

    def brightness(self, x: Floats, y: Floats) -> Floats:
        """Brightness 0 … 1 at projector coordinates of equal shape."""
        coordinate = x if self.axis == "x" else y
        return 0.5 * (1 + np.cos(2 * np.pi * (coordinate / self.period + self.shift)))


Pattern = White | Black | Gray | Xor | Phase


def draw(pattern: Pattern, size: tuple[int, int]) -> NDArray[np.uint8]:
    """The 8-bit image (height, width) of a pattern for a projector of `size` = (width, height)."""
    width, height = size
    # Only a row and a column are drawn, because a live capture waits for its pictures, and most vary along one axis.
    x, y = np.arange(width, dtype=np.float64)[None, :], np.arange(height, dtype=np.float64)[:, None]
    levels = np.rint(255 * pattern.brightness(x, y)).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(levels, (height, width)))


def count_bits(length: float, cell: float) -> int:
    """The number of bits that distinguish all cells along an axis of `length` pixels."""
    return max(1, ceil(log2(ceil(length / cell - _ROUNDING))))


def gray_sequence(axis: Axis, length: int, cell: int, *, inverses: bool = True) -> Iterator[Gray]:
    """The bits that distinguish all cells along an axis of `length` pixels, each followed by its inverse."""
    bits = count_bits(length, cell)
    for bit in range(bits):
        for inverted in (False, True) if inverses else (False,):
            yield Gray(axis, bit, bits, cell, inverted=inverted)


def xor_sequence(
    axis: Axis, length: int, cell: int, *, inverses: bool = True, above_finest: int = 0
) -> Iterator[Gray | Xor]:
    """The same cells by stripes of mostly two cells: the finest bit, and the others relative to it.

    With a base `above_finest` bits above the finest, coarser bits are relative to it, and finer ones are shown plainly.
    """
    for pattern in gray_sequence(axis, length, cell, inverses=inverses):
        base = pattern.bits - 1 - above_finest
        relative = Xor(axis, pattern.bit, pattern.bits, base, cell, inverted=pattern.inverted)
        yield relative if pattern.bit < base else pattern


def phase_sequence(axis: Axis, period: float, shifts: int) -> Iterator[Phase]:
    """One fringe in `shifts` equal steps over a cycle."""
    for step in range(shifts):
        yield Phase(axis, period, step / shifts)


def both_sequence(axis: Axis, length: int, cell: int, *, inverses: bool = True) -> Iterator[Gray | Xor]:
    """The Gray code, then the XOR code on the same finest bit."""
    yield from gray_sequence(axis, length, cell, inverses=inverses)
    yield from (p for p in xor_sequence(axis, length, cell, inverses=inverses) if isinstance(p, Xor))


_CODES: dict[Code, Callable[..., Iterator[Gray | Xor]]] = {
    "gray": gray_sequence,
    "xor": xor_sequence,
    "both": both_sequence,
}


def sequence_for(
    size: tuple[int, int],
    *,
    code: Code = "gray",
    cell: int = 8,
    inverses: bool = True,
    periods: Sequence[float] = (16.0, 6.7),
    shifts: int = 4,
) -> tuple[Pattern, ...]:
    """White, black, a code down to `cell` for each axis, then fringes of `periods` along both in `shifts` steps each.

    Each fringe along y lies between the two halves of that along x, the second of which runs backwards. So both are
    measured at the same time on average, and a slow drift shifts neither against the other. A sudden motion between
    them splits the fringe along x, which is detected.

    A cell of half the longest period leaves a quarter of that period as slack on either side of each Gray edge, so that
    no fringe order depends on a single edge. `shifts` = 0 omits the fringes.
    """
    patterns: list[Pattern] = [White(), Black()]
    axes: tuple[tuple[Axis, int], ...] = (("x", size[0]), ("y", size[1]))
    for axis, length in axes:
        patterns += _CODES[code](axis, length, cell, inverses=inverses)
    for period in periods if shifts else ():
        along_x, along_y = (list(phase_sequence(axis, period, shifts)) for axis, _ in axes)
        half = (shifts + 1) // 2
        patterns += [*along_x[:half], *along_y, *reversed(along_x[half:])]
    return tuple(patterns)


PresetName = Literal["standard", "quick", "concave"]


@dataclass(frozen=True)
class Preset:
    """The arguments of `sequence_for`: a code down to `cell` px, fringes of `periods` px in `shifts` steps each."""

    code: Code
    cell: int
    inverses: bool
    periods: tuple[float, ...]
    shifts: int

    def patterns(self, projector_size: tuple[int, int]) -> tuple[Pattern, ...]:
        """The sequence for a projector of (width, height)."""
        return sequence_for(projector_size, **asdict(self))


# Two periods whose ratio is far from simple fractions (1.382, or 2.39) seldom agree on a wrong fringe order, so that a
# wrong bit is detected. Deciding periods are not whole numbers of pixels: otherwise rounding to 256 grey levels would
# repeat in each cycle, and shift all coordinates by a thousandth of a pixel.
PRESETS: dict[PresetName, Preset] = {
    "standard": Preset("gray", cell=8, inverses=True, periods=(16.0, 6.7), shifts=4),
    "quick": Preset("gray", cell=8, inverses=False, periods=(12.3,), shifts=4),
    # Two codes that fail in different places, and fringes short enough to cancel in interreflection.
    "concave": Preset("both", cell=8, inverses=False, periods=(8.43, 6.1), shifts=4),
}


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
