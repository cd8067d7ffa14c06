"""Layouts of fringe projection: fringes of close periods, and fringes with complementary Gray codes.

Programs differ in the origin of the cosine and in the direction of its shifts. Each variant is a separate sequence
here, and the frames determine which it is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import chain, product

from scanner.importing.layout import FrameLayout, Need, SequenceOf, Size
from scanner.importing.orders import fringe, gray_bits, with_ends, x_and_y
from scanner.patterns import Axis, Gray, Pattern, count_bits

_STEPS = range(3, 9)
_AXES: tuple[tuple[Axis, ...], ...] = (("x", "y"), ("y", "x"), ("x",), ("y",))
_BEGINNINGS = (0.0, 0.25, 0.5, 0.75)
# 59, 64 and 70 periods; and n − n^(k/m) of them, after Towers, Towers and Jones, Optics Letters 28 (2003).
_USUAL = ((59, 64, 70), (30, 35, 36), (56, 63, 64), (90, 99, 100))
_KEPT = 4  # layouts of the last periods
_ANY_PERIOD_PX = 32
_ANY_COUNTS = (8, 16, 32, 64)  # of as many bits as there may be: cells and fringes fit each other on any projector

# For an axis of a projector: the periods of its fringes, and the code behind them.
_Parts = tuple[Sequence[float], Sequence[Gray]]
_AlongAxis = Callable[[Axis, Size], _Parts]


@lru_cache(_KEPT)  # a thousand functions, which remember their sequences
def fringe_layouts(periods: tuple[float, ...] | None) -> tuple[FrameLayout, ...]:
    """Return the layouts with these `periods` per picture, in the order of the frames.

    None: try the usual sets of close periods; a single fringe with a Gray code has no usual number, but fits it
    whatever the number is.
    """
    several: list[Sequence[float]]
    several = [periods] if periods else [order for usual in _USUAL for order in (usual, usual[::-1])]
    close = [partial(_close, counts) for counts in several if len(counts) > 1]
    counts = _ANY_COUNTS if periods is None else periods if len(periods) == 1 else ()
    codes = product(counts, (_complementary, _shifted), (False, True))
    beside = [partial(_beside, count, code, is_square) for count, code, is_square in codes]
    side = int(_ANY_PERIOD_PX * (periods[0] if periods else 1))
    return (
        _layout("heterodyne", "Fringes of close periods", close, side, ("projector_size",)),
        _layout(
            "gray-fringes",
            "A fringe and a complementary or shifted Gray code",
            beside,
            side,
            ("projector_size", "periods"),
        ),
    )


def _layout(name: str, title: str, along: Sequence[_AlongAxis], side: int, needs: tuple[Need, ...]) -> FrameLayout:
    ways = map(_Direction, along)
    sequences = tuple(
        one
        for way in ways
        for axes, sign, first in product(_AXES, (1, -1), _BEGINNINGS)
        for one in replace(way, axes=axes, sign=sign, first=first).with_ends()
    )
    return FrameLayout(name, title, "docs/import.md", sequences, needs, any_size=(side, side))


@dataclass(frozen=True)
class _Direction:
    """The patterns `along` each of the `axes`. `first`: a fringe's first shift; `sign`: the direction of its shifts."""

    along: _AlongAxis
    axes: tuple[Axis, ...] = ()
    sign: int = 1
    first: float = 0.0

    def with_ends(self) -> tuple[SequenceOf, ...]:
        """With white and black in all usual places, or without."""
        return (*with_ends(partial(self._sequence, 2), first=True, last=True), partial(self._sequence, 0))

    def _sequence(self, ends: int, size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
        """The sequence with as many steps as fit this many frames, `ends` of which are white and black."""
        del cell
        parts = {axis: self.along(axis, size) for axis in self.axes}
        fringes = sum(len(periods) for periods, _ in parts.values())
        codes = sum(len(code) for _, code in parts.values())
        steps, rest = divmod(frames - ends - codes, max(fringes, 1))
        if rest or steps not in _STEPS:
            return ()
        shown: list[Pattern] = []
        for axis, (periods, code) in parts.items():
            shown += chain(*(fringe(axis, period, steps, first=self.first, sign=self.sign) for period in periods))
            shown += code
        return tuple(shown)


def _close(counts: Sequence[float], axis: Axis, size: Size) -> _Parts:
    length = dict(x_and_y(size))[axis]
    return [length / count for count in counts], []


def _beside(
    count: float, code: Callable[[Axis, int, float], list[Gray]], is_square: bool, axis: Axis, size: Size
) -> _Parts:
    """A fringe and its code: as many periods along both axes, or periods of one length, `count` across the width."""
    length = dict(x_and_y(size))[axis]
    period = (size[0] if is_square else length) / count
    return [period], code(axis, length, period)


def _complementary(axis: Axis, length: int, period: float) -> list[Gray]:
    """A code of half periods: that of whole periods plus one bit, whose edges do not coincide with the phase wraps."""
    return [*gray_bits(axis, length, _plain(period / 2), inverses=False)]


def _shifted(axis: Axis, length: int, period: float) -> list[Gray]:
    """A code of whole periods, and the same half a period further."""
    bits = count_bits(length + period / 2, period)
    first = [Gray(axis, bit, bits, _plain(period)) for bit in range(bits)]
    return [*first, *(replace(bit, offset=_plain(period / 2)) for bit in first)]


def _plain(length: float) -> float:
    """A length in pixels, without the fraction of a whole number."""
    return int(length) if length == int(length) else length
