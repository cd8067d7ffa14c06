"""Building blocks of the orders of frames.

Layouts of fringe projection: fringes of close periods, and fringes with complementary Gray codes.

Programs differ in the origin of the cosine and in the direction of its shifts. Each variant is a separate sequence
here, and the frames determine which it is.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from itertools import chain, product, zip_longest

from scanner.importing.layout import FrameLayout, Need, SequenceOf, Size
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White, count_bits

_SIZES_KEPT = 128  # of projectors: more than are tried with each place of white and black
ENDS: tuple[tuple[Pattern, ...], ...] = ((White(), Black()), (Black(), White()))
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


@cache  # the same ones are in hundreds of orders
def gray_bits(
    axis: Axis,
    length: int,
    cell: float = 1,
    *,
    inverses: bool = True,
    least: int = 1,
    most: int | None = None,
    centred: bool = False,
) -> tuple[Gray, ...]:
    """The required bits of a Gray code, most significant first.

    `least`: at least this many bits, of which the first never change; `most`: at most this many, which makes cells
    coarser. `centred`: the middle of the axis is the middle of all codes.
    """
    bits = max(least, count_bits(length, cell))
    offset = (cell * 2**bits - length) // 2 if centred else 0
    bit_count = bits if most is None else min(bits, most)
    signs = (False, True) if inverses else (False,)
    return tuple(
        Gray(axis, bit, bit_count, cell * 2 ** (bits - bit_count), offset, inverted)
        for bit in range(bit_count)
        for inverted in signs
    )


def fringe(axis: Axis, period: float, steps: int, *, first: float = 0, sign: int = 1) -> Iterator[Phase]:
    """A fringe in equal steps over a cycle, from the `first` shift on, in either direction."""
    return (Phase(axis, period, first + sign * step / steps) for step in range(steps))


def x_and_y(size: Size) -> tuple[tuple[Axis, int], tuple[Axis, int]]:
    """Both axes with their lengths."""
    return ("x", size[0]), ("y", size[1])


def pairs(size: Size, cell: int, frames: int) -> tuple[Pattern, ...]:
    """All bits of x, then of y, each followed by its inverse, for any number of frames."""
    del frames
    return tuple(bit for axis, length in x_and_y(size) for bit in gray_bits(axis, length, cell))


def with_ends(
    sequence: SequenceOf, *, first: bool = False, last: bool = False, without: bool = False
) -> tuple[SequenceOf, ...]:
    """A sequence with white and black, in either order, before it, after it, or without them, as is usual."""
    sequence = lru_cache(_SIZES_KEPT)(sequence)

    def placed(before: tuple[Pattern, ...], after: tuple[Pattern, ...]) -> SequenceOf:
        return lambda size, cell, frames: (*before, *sequence(size, cell, frames), *after)

    placements = [placed((), ends) for ends in ENDS] if last else []
    placements += [placed(ends, ()) for ends in ENDS] if first else []
    return (*placements, *([sequence] if without else []))


def other_gray_orders() -> tuple[SequenceOf, ...]:
    """Gray codes in all other orders that people think of: of both axes, in either order or by turns, or of one; the
    coarsest bit first or the finest; inverses behind each bit, behind those of an axis, behind all, or none; white and
    black as in `with_ends`.
    """
    both: tuple[tuple[Axis, ...], ...] = (("x", "y"), ("y", "x"))
    in_a_row = product((*both, ("x",), ("y",)), (False,), (_by_bit, _by_axis, _at_the_end, _none))
    by_turns = product(both, (True,), (_by_bit, _at_the_end, _none))
    sequences: list[SequenceOf] = []
    for (axes, turns, arranged), fine_first in product([*in_a_row, *by_turns], (False, True)):

        def sequence(
            size: Size,
            cell: int,
            frames: int,
            axes: tuple[Axis, ...] = axes,
            turns: bool = turns,
            arranged: Arrangement = arranged,
            fine_first: bool = fine_first,
        ) -> tuple[Pattern, ...]:
            del frames
            lengths = dict(x_and_y(size))
            runs = [[*gray_bits(axis, lengths[axis], cell, inverses=False)] for axis in axes]
            runs = [bits[::-1] for bits in runs] if fine_first else runs
            return arranged([[bit for turn in zip_longest(*runs) for bit in turn if bit]] if turns else runs)

        sequences += with_ends(sequence, first=True, last=True, without=True)
    return tuple(sequences)


# The frames of runs of bits, with their inverses.
Arrangement = Callable[[list[list[Gray]]], tuple[Pattern, ...]]


@cache
def _inverse(bit: Gray) -> Gray:
    return replace(bit, inverted=True)


def _inverted(bits: list[Gray]) -> list[Gray]:
    return [*map(_inverse, bits)]


def _by_bit(runs: list[list[Gray]]) -> tuple[Pattern, ...]:
    return tuple(frame for bits in runs for pair in zip(bits, _inverted(bits), strict=True) for frame in pair)


def _by_axis(runs: list[list[Gray]]) -> tuple[Pattern, ...]:
    return tuple(frame for bits in runs for frame in (*bits, *_inverted(bits)))


def _at_the_end(runs: list[list[Gray]]) -> tuple[Pattern, ...]:
    every = [bit for bits in runs for bit in bits]
    return (*every, *_inverted(every))


def _none(runs: list[list[Gray]]) -> tuple[Pattern, ...]:
    return tuple(bit for bits in runs for bit in bits)


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
        sequence
        for way in ways
        for axes, sign, first in product(_AXES, (1, -1), _BEGINNINGS)
        for sequence in replace(way, axes=axes, sign=sign, first=first).with_ends()
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
        patterns: list[Pattern] = []
        for axis, (periods, code) in parts.items():
            patterns += chain(*(fringe(axis, period, steps, first=self.first, sign=self.sign) for period in periods))
            patterns += code
        return tuple(patterns)


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
