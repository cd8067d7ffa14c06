"""Bayesian model selection: which of the terms that may be zero a rig's lenses, or a board, have.

With all terms free the posterior is close to a Gaussian, and the evidence for leaving some out is the Savage–Dickey
ratio (Dickey 1971, Ann. Math. Stat. 42, 204).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from calib.numerics import Floats, Ints
from calib.refinement.parameters import CAMERA, PROJECTOR, TANGENTIAL, THIRD_RADIAL

_NEGLIGIBLE = 1e-6  # of the probability of the most probable choice
_OF_DEVICE = ((*TANGENTIAL, *THIRD_RADIAL), TANGENTIAL, THIRD_RADIAL, ())

FURTHER_TERMS = tuple(device.start + term for device in (CAMERA, PROJECTOR) for term in (*TANGENTIAL, *THIRD_RADIAL))
LENS_CHOICES = tuple(
    tuple(device.start + term for device, terms in zip((CAMERA, PROJECTOR), each, strict=True) for term in terms)
    for each in product(_OF_DEVICE, _OF_DEVICE)
)


@dataclass(frozen=True)
class Terms:
    """`zero`: the columns that are left out; `probability` of that among all choices; `spread`: the covariance that
    the other choices' answers add, as large as the one with all terms free.
    """

    zero: tuple[int, ...]
    probability: float
    spread: Floats


def most_probable(values: Floats, covariance: Floats, sigma: Floats, choices: Collection[Sequence[int]]) -> Terms:
    """Of choices of columns to leave out, all being equally likely beforehand.

    `values` (size,), `covariance` (size, size): with all terms free; `sigma` (size,): the prior's, around zero.
    """
    zeros = sorted({tuple(int(column) for column in zero if sigma[column] > 0) for zero in choices})
    candidates = np.array(sorted({column for zero in zeros for column in zero}), np.int64)
    place = {int(column): i for i, column in enumerate(candidates)}
    # In units of the prior's sigma, so that neither matrix is badly scaled.
    scale = sigma[candidates]
    block, deviation = covariance[np.ix_(candidates, candidates)] / np.outer(scale, scale), values[candidates] / scale
    logs, solutions = np.empty(len(zeros)), np.zeros((len(zeros), len(candidates)))
    for i, zero in enumerate(zeros):
        logs[i] = _left_out(block, deviation, np.array([place[column] for column in zero], np.int64), solutions[i])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    best = int(np.argmax(weights))
    likely = weights > _NEGLIGIBLE
    apart = -(solutions[likely] - solutions[best]) / scale @ covariance[:, candidates].T
    spread: Floats = (apart * weights[likely, None]).T @ apart
    return Terms(zeros[best], float(weights[best]), spread)


def _left_out(block: Floats, deviation: Floats, chosen: Ints, solution: Floats) -> float:
    """Logarithm of the Savage–Dickey ratio; `solution` (candidates,) is filled in with block⁻¹ values."""
    if not len(chosen):
        return 0.0
    part = block[np.ix_(chosen, chosen)]
    solved = np.linalg.solve(part, deviation[chosen])
    solution[chosen] = solved
    return -0.5 * float(deviation[chosen] @ solved + np.linalg.slogdet(part)[1])
