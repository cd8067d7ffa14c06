"""Gray code words → the interval of the projector axis that they leave."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.arrays import Bools
from scanner.decoding.arrays import Floats32, Words
from scanner.decoding.plan import AxisPlan

# A table of all words is looked up faster than their cells are computed, as long as it is small.
_MOST_TABLE_BITS = 16


@dataclass(frozen=True)
class Interval:
    """Where the Gray codes put each pixel: `centre` ± `half` projector pixels, arrays of one shape or of one element.

    `outside`: the code is that of no projector pixel. `contradictory`: two codes have no interval in common.
    """

    centre: Floats32
    half: Floats32
    outside: Bools
    contradictory: Bools


def interval_of(plan: AxisPlan, words: Sequence[Words]) -> Interval:
    """The interval common to all Gray codes of an axis, given the words of each; without codes the whole axis."""
    if len(plan.codes) != 1 or plan.codes[0].bits > _MOST_TABLE_BITS or words[0].size <= 1 << plan.codes[0].bits:
        return _interval(plan, words)
    table = _interval(plan, [np.arange(1 << plan.codes[0].bits, dtype=words[0].dtype)])
    return Interval(
        np.take(table.centre.ravel(), words[0]),
        np.take(table.half.ravel(), words[0]),
        np.take(table.outside.ravel(), words[0]),
        np.zeros((1, 1), np.bool_),
    )


def _interval(plan: AxisPlan, words: Sequence[Words]) -> Interval:
    first, last = np.full((1, 1), -0.5, np.float32), np.full((1, 1), plan.length - 0.5, np.float32)
    low, high, outside = first, last, np.zeros((1, 1), np.bool_)
    for code, word in zip(plan.codes, words, strict=True):
        start: Floats32 = cell_numbers(word).astype(np.float32)
        start *= np.float32(code.cell)
        start -= np.float32(code.offset + 0.5)
        end = start + np.float32(code.cell)
        outside = outside | (end <= first) | (start >= last)
        low, high = np.maximum(low, start), np.minimum(high, end)
    # Codes whose edges are a little blurred may miss each other by as little.
    contradictory = low - high > plan.cell / 2
    half = np.minimum(np.float32(0.5) * np.abs(high - low), np.float32(plan.cell / 2))
    return Interval(np.float32(0.5) * (low + high), half, outside, contradictory)


def cell_numbers(words: Words) -> Words:
    """Gray code words → cell numbers, of the same type: each bit is the exclusive or of it and all bits above."""
    numbers = words.copy()
    shift = 1
    while shift < 8 * words.itemsize:
        np.bitwise_xor(numbers, numbers >> shift, out=numbers)
        shift *= 2
    return numbers
