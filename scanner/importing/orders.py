"""Building blocks of the orders of frames."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, lru_cache
from itertools import product, zip_longest

from scanner.importing.layout import SequenceOf, Size
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White, count_bits

_SIZES_KEPT = 128  # of projectors: more than are tried with each place of white and black
ENDS: tuple[tuple[Pattern, ...], ...] = ((White(), Black()), (Black(), White()))


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
    shown = bits if most is None else min(bits, most)
    signs = (False, True) if inverses else (False,)
    return tuple(
        Gray(axis, bit, shown, cell * 2 ** (bits - shown), offset, inverted)
        for bit in range(shown)
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

    found = [placed((), ends) for ends in ENDS] if last else []
    found += [placed(ends, ()) for ends in ENDS] if first else []
    return (*found, *([sequence] if without else []))


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
