"""Gray code words → the interval of the projector axis that they leave."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, compiled
from scanner.decoding.arrays import Floats32, Words
from scanner.decoding.sequence_plan import AxisPlan

_HALF, _ONE = np.float32(0.5), np.float32(1)


@dataclass(frozen=True)
class Interval:
    """Where the Gray codes put each pixel: from `low` to `high` in projector pixels; arrays (P,).

    `outside`: the code is that of no projector pixel. `contradictory`: two codes have no interval in common.
    """

    low: Floats32
    high: Floats32
    outside: Bools
    contradictory: Bools

    @property
    def centre(self) -> Floats32:
        """The middle of it."""
        return _HALF * (self.low + self.high)

    @property
    def possible(self) -> Bools:
        """Where the codes make sense."""
        return ~(self.outside | self.contradictory)


def interval_of(
    plan: AxisPlan, words: Sequence[Words], pixels: int, undecided: Mapping[int, Words] | None = None
) -> Interval:
    """The interval common to all Gray codes of an axis, given the words (P,) of each; without codes the whole axis.

    `undecided`: for codes by number, the bits (P,) that are set where a pixel does without them.
    """
    first, last = np.float32(-0.5), np.float32(plan.length - 0.5)
    low, high = np.full(pixels, first), np.full(pixels, last)
    outside, contradictory = np.empty(pixels, np.bool_), np.empty(pixels, np.bool_)
    for number, (code, of_code) in enumerate(zip(plan.codes, words, strict=True)):
        cell, before = np.float32(code.cell), np.float32(code.offset + 0.5)
        if undecided and number in undecided:
            numbers: Floats32 = cell_numbers(of_code).astype(np.float32)
            ends = numbers + 1
            _widen(of_code, undecided[number], numbers, ends)
            _narrow(numbers, ends, cell, before, low, high)
        else:
            _narrow_to_cell(of_code, cell, before, low, high)
    # Codes whose edges are a little blurred may miss each other by as little.
    _settle(first, last, np.float32(plan.cell / 2), low, high, outside, contradictory)
    return Interval(low, high, outside, contradictory)


def cell_numbers(words: Words) -> Words:
    """Gray code words → cell numbers, of the same type: each bit is the exclusive or of it and all bits above."""
    numbers = words.copy()
    shift = 1
    while shift < 8 * words.itemsize:
        np.bitwise_xor(numbers, numbers >> shift, out=numbers)
        shift *= 2
    return numbers


def _widen(words: Words, undecided: Words, numbers: Floats32, ends: Floats32) -> None:
    """Add the cells that a pixel may be in as well, if bits of its word are undecided; all (P,), in place.

    A bit is undecided along the edge between two cells that differ in it: it is in one or the other. Else, and where
    finer ones are undecided too, the stripes of the bit are too fine: all that the coarser bits leave is possible.
    """
    where = np.flatnonzero(undecided)
    word, bits, number = words[where].astype(np.uint32), undecided[where].astype(np.uint32), numbers[where]
    other = cell_numbers(word ^ bits).astype(np.float32)
    is_edge = (bits & (bits - np.uint32(1)) == 0) & (np.abs(other - number) == 1)
    size = np.exp2(np.floor(np.log2(bits)) + 1).astype(np.float32)
    start = np.where(is_edge, np.minimum(number, other), np.floor(number / size) * size)
    numbers[where], ends[where] = start, start + np.where(is_edge, np.float32(2), size)


@compiled
def _narrow(
    numbers: Floats32, ends: Floats32, cell: np.float32, before: np.float32, low: Floats32, high: Floats32
) -> None:
    """What the cells of one code, from a number to an end, leave of the intervals; it begins so far before pixel 0."""
    for i in range(len(numbers)):
        start, end, first, last = numbers[i] * cell - before, ends[i] * cell - before, low[i], high[i]
        low[i] = max(first, start)
        high[i] = min(last, end)


@compiled
def _narrow_to_cell(words: Words, cell: np.float32, before: np.float32, low: Floats32, high: Floats32) -> None:
    """The same with the cell that each of the `words` (P,) says, whose number is that of `cell_numbers`."""
    for i in range(len(words)):
        number = np.uint32(words[i])
        number ^= number >> np.uint32(1)
        number ^= number >> np.uint32(2)
        number ^= number >> np.uint32(4)
        number ^= number >> np.uint32(8)
        number ^= number >> np.uint32(16)
        at = np.float32(np.int32(number))
        start, end, first, last = at * cell - before, (at + _ONE) * cell - before, low[i], high[i]
        low[i] = max(first, start)
        high[i] = min(last, end)


@compiled
def _settle(
    first: np.float32,
    last: np.float32,
    slack: np.float32,
    low: Floats32,
    high: Floats32,
    outside: Bools,
    contradictory: Bools,
) -> None:
    """Note intervals that are not between `first` and `last`, or end before they begin; of these, exchange the ends."""
    for i in range(len(low)):
        start, end = low[i], high[i]
        outside[i] = (start >= last) | (end <= first)
        contradictory[i] = start - end > slack
        low[i] = min(start, end)
        high[i] = max(start, end)
