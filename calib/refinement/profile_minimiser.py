"""The nearest minimum of the cost, down the profile likelihood of the camera's focal length."""

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
_SLOW = 0.1


def minimise(
    captures: Sequence[Cells],
    state: State,
    prior: Prior,
    variances: Sequence[Floats],
    *,
    tolerance: float = CONVERGED,
    ceiling: float = np.inf,
) -> Fit:
    """The nearest minimum, down the profile along the camera's focal length.

    Ends when a further step promises to lower the cost by less than `tolerance`; given up where the cost would stay
    above `ceiling`.

    The valley is curved: a joint step soon leaves it, and the many small ones that stay in it look like convergence.
    So after each joint Newton step everything but the focal is relaxed back to the valley's floor, along which the
    cost is nearly a parabola.
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
    """Levenberg–Marquardt over the free columns of the prior.

    Ends when Newton's decrement, the cost that a full step promises to gain, falls below `tolerance`, or that share
    of a hundredth of the cost; or when the cost, once it goes down slowly, would stay above `ceiling`.
    """

    def moved(fit: Fit, step: Floats) -> Fit:
        return evaluate(captures, fit.state.moved(step), prior, variances)

    def enough(cost: float, decrement: float) -> bool:
        hopeless = decrement < _SLOW * cost and cost - decrement > ceiling
        return hopeless or decrement < tolerance * (1 + 0.01 * cost)

    fit = evaluate(captures, state, prior, variances)
    return descend(fit, moved, enough, _DAMPING, steps, free=prior.free_columns)
