"""Where two codes of an axis contradict each other, choose the one that the fringes agree with.

Strong interreflection inverts the coarse bits of a Gray code. It does not invert those of an XOR code, but all of these
are uncertain along the edges of its fine stripes. Fringes of two periods are too ambiguous to be a code of their own,
yet hardly any wrong code agrees with them. So two of the three must agree, and no other two on a different answer.
(Gupta et al., CVPR 2011, keep what two of four codes agree on.)

The base bit of an XOR code is one frame for both codes. Where it is misread, both codes are wrong; so its inverse is
tried as well.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calib.numerics import Words
from scanner.decoding.codes import Interval, interval_of
from scanner.decoding.fringes.phase_unwrapping import Orders, Tolerances, Wrapped, unwrap
from scanner.decoding.sequence_plan import AxisPlan, GrayCode


def resolve_contradictory_codes(
    plan: AxisPlan,
    words: Sequence[Words],
    wrapped: Wrapped,
    tolerances: Tolerances,
    interval: Interval,
    orders: Orders,
) -> None:
    """Resolve contradictions between codes, from the words (P,) of each, where the fringes agree with exactly one of
    them.

    That code's interval and fringe orders replace those of all codes together, in `interval` and `orders`.
    """
    if len(plan.codes) < 2 or not interval.contradictory.any():
        return
    where = np.flatnonzero(interval.contradictory)
    there = Wrapped(wrapped.positions[:, where], wrapped.variances[:, where])
    answers = list(_answers(plan, [of_code[where] for of_code in words]))
    followed = [unwrap(plan, answer, there, tolerances) for answer in answers]
    agrees = np.array([f.flags | answer.flags for f, answer in zip(followed, answers, strict=True)]) == 0
    coordinates = np.stack([f.coordinates[-1] for f in followed])
    first, last = (
        end(np.where(agrees, coordinates, np.float32(np.nan)), axis=0) for end in (np.fmin.reduce, np.fmax.reduce)
    )
    # NaN, and so not clear, where none agrees.
    is_clear = last - first < np.float32(plan.fringes[-1].period / 2)
    best = np.argmax(agrees, axis=0)
    for number, (answer, orders_of) in enumerate(zip(answers, followed, strict=True)):
        chosen = is_clear & (best == number)
        at = where[chosen]
        interval.low[at], interval.high[at] = answer.low[chosen], answer.high[chosen]
        orders.coordinates[:, at] = orders_of.coordinates[:, chosen]
        interval.flags[at] = orders.flags[at] = 0


def _answers(plan: AxisPlan, words: Sequence[Words]) -> Iterator[Interval]:
    """Yield the interval of each code by itself, then that of the codes that share an XOR base with
    this bit inverted.
    """
    for code, of_code in zip(plan.codes, words, strict=True):
        yield interval_of(replace(plan, codes=(code,)), [of_code], len(of_code))
    for base_code in plan.codes:
        if base_code.base is None:
            continue
        sharing = [
            (code, _misread(code, base_code.base, of_code))
            for code, of_code in zip(plan.codes, words, strict=True)
            if (code.bits, code.cell, code.offset) == (base_code.bits, base_code.cell, base_code.offset)
        ]
        codes, otherwise = zip(*sharing, strict=True)
        yield interval_of(replace(plan, codes=codes), otherwise, len(otherwise[0]))


def _misread(code: GrayCode, bit: int, words: Words) -> Words:
    """Return the words (P,) with one bit, as shown, inverted."""
    return code.relative_to_base(code.relative_to_base(words) ^ words.dtype.type(1 << code.bits - 1 - bit))
