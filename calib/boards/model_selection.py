"""Bayesian model selection: which terms each lens has, whether pixels are square, and how the board is bent.

As for corners (`calib.refinement.distortion_model_selection`): with all terms free the posterior is close to a
Gaussian, and the evidence for leaving some out is the Savage–Dickey ratio (Dickey 1971, Ann. Math. Stat. 42, 204).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from calib.boards.likelihood import Prior
from calib.boards.parameters import ASPECT, BEND, CAMERA, LENS, PROJECTOR, SHARED
from calib.numerics import Floats, Ints

_K1, _K2, _P1, _P2, _K3 = range(LENS.start, LENS.stop)
_RADIAL = ((_K1, _K2, _K3), (_K2, _K3), (_K3,), ())  # left out, with 0, 1, 2, 3 radial terms
_OF_DEVICE = tuple(
    (*radial, *tangential, *aspect)
    for radial in _RADIAL
    for tangential in ((_P1, _P2), ())
    for aspect in ((ASPECT,), ())
)
_OF_BEND = (tuple(range(7)), (3, 4, 5, 6), ())


@dataclass(frozen=True)
class Terms:
    """`zero`: the columns that are left out; `probability` of that among all choices; `spread` (SHARED, SHARED): the
    covariance that the other choices' answers add.
    """

    zero: tuple[int, ...]
    probability: float
    spread: Floats


def choose_terms(values: Floats, covariance: Floats, prior: Prior) -> Terms:
    """The most probable choice, all being equally likely beforehand.

    `values` (SHARED,), `covariance` (SHARED, SHARED): with all terms free.
    """
    choices = {
        tuple(column for column in zero if prior.sigma[column] > 0)
        for zero in (
            (
                *(CAMERA.start + column for column in camera),
                *(PROJECTOR.start + column for column in projector),
                *(BEND.start + column for column in bend),
            )
            for camera, projector, bend in product(_OF_DEVICE, _OF_DEVICE, _OF_BEND)
        )
    }
    zeros = sorted(choices)
    candidates = np.array(sorted({column for zero in zeros for column in zero}))
    place = {int(column): i for i, column in enumerate(candidates)}
    block = covariance[np.ix_(candidates, candidates)]
    # In units of the prior's sigma, so that neither matrix is badly scaled.
    scale = prior.sigma[candidates]
    block, deviation = block / np.outer(scale, scale), values[candidates] / scale
    logs, solutions = np.empty(len(zeros)), np.zeros((len(zeros), len(candidates)))
    for i, zero in enumerate(zeros):
        chosen = np.array([place[column] for column in zero], np.int64)
        logs[i] = _left_out(block, deviation, chosen, solutions[i])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    best = int(np.argmax(weights))
    likely = weights > 1e-6
    apart = -(solutions[likely] - solutions[best]) / scale @ covariance[:, candidates].T
    spread: Floats = (apart * weights[likely, None]).T @ apart
    return Terms(zeros[best], float(weights[best]), spread.reshape(SHARED, SHARED))


def _left_out(block: Floats, deviation: Floats, chosen: Ints, solution: Floats) -> float:
    """Logarithm of the Savage–Dickey ratio; `solution` (candidates,) is filled in with block⁻¹ values."""
    if not len(chosen):
        return 0.0
    part = block[np.ix_(chosen, chosen)]
    solved = np.linalg.solve(part, deviation[chosen])
    solution[chosen] = solved
    return -0.5 * float(deviation[chosen] @ solved + np.linalg.slogdet(part)[1])
