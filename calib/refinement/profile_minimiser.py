"""Minimise the cost along the profile of the camera's focal length."""

from collections.abc import Sequence

import numpy as np

from calib.numerics import Damping, Floats, descend, newton
from calib.refinement.likelihood import Fit, Prior, evaluate
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import CAMERA, State

CONVERGED = 1e-3  # in cost: a thirtieth of a sigma
_STEPS = 40
_DAMPING = Damping(first=1e-7, least=1e-13, most=1e4, growth=30.0, relief=1 / 30)
_LONGEST_STEP = 0.1  # of log f
_HALVINGS = 4
# Largest predicted decrease, as a share of the cost, at which a fit is given up that would stay above the ceiling; and
# the same where it would stay that many times above it. Most steps of a sweep are taken where nothing fits.
_SLOW, _SLOW_IF_FAR, _FAR = 0.1, 0.5, 10.0


def minimise(
    captures: Sequence[Cells],
    state: State,
    prior: Prior,
    variances: Sequence[Floats],
    *,
    tolerance: float = CONVERGED,
    ceiling: float = np.inf,
) -> Fit:
    """Find the nearest minimum by descending the profile along the camera's focal length.

    Stops when the predicted decrease of the cost is below `tolerance`, or when the cost would stay above `ceiling`.

    The valley is curved: a long joint step leaves it, and a series of short ones looks like convergence. So after each
    joint Newton step everything but the focal is relaxed back to the valley's floor, along which the cost is nearly a
    parabola.
    """
    anchored = prior.holding(CAMERA.start)
    fit = relax(captures, state, anchored, variances, tolerance=tolerance)
    for _ in range(_STEPS):
        step, decrement, _ = newton(fit, prior.free_columns, _DAMPING.least)
        if not np.isfinite(fit.cost) or decrement < tolerance or fit.cost - decrement > ceiling:
            break
        step *= min(1.0, _LONGEST_STEP / max(abs(step[CAMERA.start]), 1e-12))
        for _ in range(_HALVINGS):
            trial = relax(captures, fit.state.moved(step), anchored, variances, tolerance=tolerance)
            if trial.cost <= fit.cost:
                break
            step /= 4
        else:
            break
        fit = trial
    return fit


def relax(
    captures: Sequence[Cells],
    state: State,
    prior: Prior,
    variances: Sequence[Floats],
    *,
    tolerance: float = CONVERGED,
    steps: int = _STEPS,
    ceiling: float = np.inf,
) -> Fit:
    """Minimise over the free columns of the prior by Levenberg–Marquardt.

    Stops when Newton's decrement, the predicted decrease of a full step, falls below `tolerance`, or below that share
    of a hundredth of the cost; or when the cost decreases slowly, compared with how far above `ceiling` it would stay.
    """

    def moved(fit: Fit, step: Floats) -> Fit:
        return evaluate(captures, fit.state.moved(step), prior, variances)

    def enough(cost: float, decrement: float) -> bool:
        remaining = cost - decrement
        hopeless = remaining > ceiling and decrement < (_SLOW_IF_FAR if remaining > _FAR * ceiling else _SLOW) * cost
        return hopeless or decrement < tolerance * (1 + 0.01 * cost)

    fit = evaluate(captures, state, prior, variances)
    return descend(fit, moved, enough, _DAMPING, steps, free=prior.free_columns)
