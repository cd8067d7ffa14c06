"""How many radial terms each lens has: none, k1, or k1 and k2, by the evidence for each.

With all terms free the posterior is close to a Gaussian. The evidence for leaving some out, against keeping them, is
the Savage–Dickey ratio: the posterior density of zero over its prior density (Dickey 1971, Ann. Math. Stat. 42, 204).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from calib.numerics import Floats
from calib.refinement.likelihood import Fit, Prior
from calib.refinement.parameters import CAMERA, PROJECTOR

# Columns that are zero when a lens has this many terms.
_ZERO_BY_TERMS = ((3, 4), (4,), ())


@dataclass(frozen=True)
class LensOrder:
    """`terms`: number of radial terms of (camera, projector); `probability` of that order among all.

    `zero`: the columns left out. `spread` (size, size): the covariance that the other orders' answers add.
    """

    terms: tuple[int, int]
    probability: float
    zero: tuple[int, ...]
    spread: Floats


def choose_lens_order(fit: Fit, covariance: Floats, prior: Prior) -> LensOrder:
    """The most probable order, all being equally likely beforehand; `fit` and `covariance` have all terms free.

    A term that the prior does not leave free is none to choose.
    """
    values = fit.state.additive()
    orders, logs, shifts = [], [], []
    most = [int(np.count_nonzero(prior.free[device][3:])) for device in (CAMERA, PROJECTOR)]
    for terms in product(range(most[0] + 1), range(most[1] + 1)):
        zero = [
            device.start + column
            for device, count in zip((CAMERA, PROJECTOR), terms, strict=True)
            for column in _ZERO_BY_TERMS[count]
            if prior.free[device.start + column]
        ]
        orders.append((terms, tuple(zero)))
        shift, log_ratio = _left_out(values, covariance, prior, zero)
        shifts.append(shift)
        logs.append(log_ratio)
    weights = np.exp(np.array(logs) - np.max(logs))
    weights /= weights.sum()
    best = int(np.argmax(weights))
    apart = np.stack(shifts) - shifts[best]
    spread: Floats = (apart * weights[:, None]).T @ apart
    return LensOrder(orders[best][0], float(weights[best]), orders[best][1], spread)


def _left_out(values: Floats, covariance: Floats, prior: Prior, zero: list[int]) -> tuple[Floats, float]:
    """How the columns (size,) move when some are held at zero, and the logarithm of the Savage–Dickey ratio."""
    if not zero:
        return np.zeros(len(values)), 0.0
    block = covariance[np.ix_(zero, zero)]
    solved = np.linalg.solve(block, values[zero])
    posterior = values[zero] @ solved + np.linalg.slogdet(block)[1]
    before = float(np.sum(np.log(prior.sigma[zero] ** 2)))  # the prior's mean is zero
    return -covariance[:, zero] @ solved, 0.5 * (before - posterior)
