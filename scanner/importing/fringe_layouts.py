"""Layouts of fringe projection: fringes of close periods, and fringes with complementary Gray codes.

Programs differ in the origin of the cosine and in the direction of its shifts. Each variant is a separate sequence
here, and the frames determine which it is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, product

from scanner.importing.layout import FrameLayout, SequenceOf, Size
from scanner.importing.orders import bits_of, fringe, gray_bits, with_ends, x_and_y
from scanner.patterns import Axis, Gray, Pattern

_STEPS = range(3, 9)
_AXES: tuple[tuple[Axis, ...], ...] = (("x", "y"), ("y", "x"), ("x",), ("y",))
_BEGINNINGS = (0.0, 0.25, 0.5, 0.75)
# 59, 64 and 70 periods; and n − n^(k/m) of them, after Towers, Towers and Jones, Optics Letters 28 (2003).
_USUAL = ((59, 64, 70), (30, 35, 36), (56, 63, 64), (90, 99, 100))
_ANY_PERIOD_PX = 32

# For an axis of given length: the periods of its fringes, and the code behind them; no periods if impossible.
_Parts = tuple[Sequence[float], Sequence[Gray]]
_AlongAxis = Callable[[Axis, int], _Parts]


def fringe_layouts(periods: Sequence[float] | None) -> tuple[FrameLayout, ...]:
    """Return the layouts with these `periods` per picture, in the order of the frames.

    None: try the usual sets of close periods; a single fringe with a Gray code has no usual number.
    """
    several = [periods] if periods else [order for usual in _USUAL for order in (usual, usual[::-1])]
    close = [partial(_close, counts) for counts in several if len(counts) > 1]
    count = periods[0] if periods and len(periods) == 1 else 0.0
    beside = [partial(_beside, count, code) for code in (_complementary, _shifted)] if count else []
    side = int(_ANY_PERIOD_PX * (count or 1))
    return (
        _layout("heterodyne", "Fringes of close periods", close, side),
        _layout("gray-fringes", "A fringe and a complementary or shifted Gray code", beside, side),
    )


def _layout(name: str, title: str, along: Sequence[_AlongAxis], side: int) -> FrameLayout:
    ways = map(_Direction, along)
    sequences = tuple(
        one
        for way in ways
        for axes, sign, first in product(_AXES, (1, -1), _BEGINNINGS)
        for one in replace(way, axes=axes, sign=sign, first=first).with_ends()
    )
    return FrameLayout(name, title, "docs/import.md", sequences, ("projector_size",), any_size=(side, side))


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
        lengths = dict(x_and_y(size))
        parts = {axis: self.along(axis, lengths[axis]) for axis in self.axes}
        fringes = sum(len(periods) for periods, _ in parts.values())
        codes = sum(len(code) for _, code in parts.values())
        steps, rest = divmod(frames - ends - codes, max(fringes, 1))
        if rest or steps not in _STEPS or not all(periods for periods, _ in parts.values()):
            return ()
        shown: list[Pattern] = []
        for axis, (periods, code) in parts.items():
            shown += chain(*(fringe(axis, period, steps, first=self.first, sign=self.sign) for period in periods))
            shown += code
        return tuple(shown)


def _close(counts: Sequence[float], axis: Axis, length: int) -> _Parts:
    del axis
    return [length / count for count in counts], []


def _beside(count: float, code: Callable[[Axis, int, int], list[Gray]], axis: Axis, length: int) -> _Parts:
    period = length / count
    return ([period], code(axis, length, int(period))) if period % 2 == 0 else ([], [])


def _complementary(axis: Axis, length: int, period: int) -> list[Gray]:
    """A code of half periods: that of whole periods plus one bit, whose edges do not coincide with the phase wraps."""
    return [*gray_bits(axis, length, period // 2, inverses=False)]


def _shifted(axis: Axis, length: int, period: int) -> list[Gray]:
    """A code of whole periods, and the same half a period further."""
    bits = bits_of(length + period // 2, period)
    first = [Gray(axis, bit, bits, period) for bit in range(bits)]
    return [*first, *(replace(bit, offset=period // 2) for bit in first)]
