"""Where two codes of an axis contradict each other: the one that the fringes agree with.

Where more light has bounced than comes straight from the projector, it turns over the coarse bits of a Gray code. It
does not turn over those of an XOR code, but all of these are doubtful along the edges of its fine stripes. Fringes of
two periods repeat too soon to be a code of their own, and still agree with hardly any wrong one. So two of the three
must agree, and no other two on anything else. (Gupta et al., CVPR 2011, keep what two of four codes agree on.)
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from scanner.decoding.arrays import Words
from scanner.decoding.codes.gray_code import Interval, interval_of
from scanner.decoding.fringes.phase_unwrapping import Orders, Tolerances, Wrapped, unwrap
from scanner.decoding.sequence_plan import AxisPlan


def let_fringes_decide(
    plan: AxisPlan,
    words: Sequence[Words],
    wrapped: Wrapped,
    tolerances: Tolerances,
    interval: Interval,
    orders: Orders,
) -> None:
    """Settle contradictions between codes, given the words (P,) of each, where the fringes agree with one of them only.

    Its interval and its orders take the place of those of all codes together, in `interval` and `orders`.
    """
    if len(plan.codes) < 2 or not interval.contradictory.any():
        return
    where = np.flatnonzero(interval.contradictory)
    there = Wrapped(wrapped.positions[:, where], wrapped.variances[:, where])
    alone = [
        interval_of(replace(plan, codes=(code,)), [of_code[where]], len(where))
        for code, of_code in zip(plan.codes, words, strict=True)
    ]
    followed = [unwrap(plan, of_code, there, tolerances) for of_code in alone]
    agrees = np.array(
        [found.agree & found.unique & of_code.possible for found, of_code in zip(followed, alone, strict=True)]
    )
    is_clear = np.count_nonzero(agrees, axis=0) == 1
    for of_code, found, agreeing in zip(alone, followed, agrees, strict=True):
        chosen = agreeing & is_clear
        at = where[chosen]
        interval.low[at], interval.high[at] = of_code.low[chosen], of_code.high[chosen]
        interval.outside[at] = interval.contradictory[at] = False
        orders.coordinates[:, at] = found.coordinates[:, chosen]
        orders.agree[at] = orders.unique[at] = True
