"""Gray code words → the interval of the projector axis that they leave."""

from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools
from calib.compiled import compiled
from scanner.decoding.arrays import Floats32, Words
from scanner.decoding.plan import AxisPlan

_HALF = np.float32(0.5)


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


def interval_of(plan: AxisPlan, words: Words) -> Interval:
    """The interval common to all Gray codes of an axis, given the words (codes, P); without codes the whole axis."""
    count = words.shape[1]
    first, last = np.float32(-0.5), np.float32(plan.length - 0.5)
    low, high = np.full(count, first), np.full(count, last)
    outside, contradictory = np.empty(count, np.bool_), np.empty(count, np.bool_)
    for code, of_code in zip(plan.codes, words, strict=True):
        _narrow(of_code, np.float32(code.cell), np.float32(code.offset + 0.5), low, high)
    # Codes whose edges are a little blurred may miss each other by as little.
    _settle(first, last, np.float32(plan.cell / 2), low, high, outside, contradictory)
    return Interval(low, high, outside, contradictory)


def cell_numbers(words: Words) -> Words:
    """Gray code words (P,) → cell numbers, both of 32 bits."""
    numbers = np.empty_like(words)
    _number(words, numbers)
    return numbers


@compiled
def _cell_number(word: np.uint32) -> np.uint32:
    """Of a Gray code word: each bit is the exclusive or of it and all bits above."""
    # The type is said again and again because Numba's own integers have 64 bits.
    word = np.uint32(word ^ (word >> np.uint32(1)))
    word = np.uint32(word ^ (word >> np.uint32(2)))
    word = np.uint32(word ^ (word >> np.uint32(4)))
    word = np.uint32(word ^ (word >> np.uint32(8)))
    return np.uint32(word ^ (word >> np.uint32(16)))


@compiled
def _number(words: Words, numbers: Words) -> None:
    for i in range(len(words)):
        numbers[i] = _cell_number(words[i])


@compiled
def _narrow(words: Words, cell: np.float32, before: np.float32, low: Floats32, high: Floats32) -> None:
    """What the words of one code, whose cells begin so far before the first pixel, leave of the intervals."""
    for i in range(len(words)):
        # Signed numbers convert faster; the cells of no axis reach 2³¹.
        start = np.float32(np.int32(_cell_number(words[i]))) * cell - before
        low[i] = max(low[i], start)
        high[i] = min(high[i], start + cell)


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
