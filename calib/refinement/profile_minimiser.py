"""The nearest minimum of the cost: down the valley along the camera's focal length, everything else on its floor."""

from collections.abc import Sequence

import numpy as np

from calib.numerics import Floats
from calib.refinement.likelihood import Fit, Prior, evaluate
from calib.refinement.match_cells import Cells
from calib.refinement.parameters import CAMERA, State

CONVERGED = 1e-3  # in cost: a thirtieth of a sigma
_STEPS = 40
_DAMPING = 1e-7  # of a normal matrix scaled to unit diagonal
_LEAST_DAMPING = 1e-13
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
        step, decrement = _newton(fit, prior, 0.0)
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
    damping = _DAMPING
    fit = evaluate(captures, state, prior, variances)
    for _ in range(steps):
        step, decrement = _newton(fit, prior, damping)
        if not np.isfinite(fit.cost) or decrement < tolerance * (1 + 0.01 * fit.cost):
            break
        if decrement < _SLOW * fit.cost and fit.cost - decrement > ceiling:
            break
        trial = evaluate(captures, fit.state.moved(step), prior, variances)
        if trial.cost <= fit.cost:
            fit = trial
            damping = max(damping / 30, _LEAST_DAMPING)
        elif damping > 1e4:
            break
        else:
            damping = 30 * damping
    return fit


def _newton(fit: Fit, prior: Prior, damping: float) -> tuple[Floats, float]:
    """The damped Gauss–Newton step (size,) over the free columns, and the gain that it promises."""
    free = prior.free_columns
    normal = fit.information[free[:, None], free]
    scale = np.sqrt(normal.diagonal()) + 1e-12
    damped = normal / (scale[:, None] * scale)
    damped.ravel()[:: len(free) + 1] += max(damping, _LEAST_DAMPING)
    slope = fit.gradient[free] / scale
    downhill = np.linalg.solve(damped, slope)
    step = np.zeros(len(prior.mean))
    step[free] = -downhill / scale
    return step, float(slope @ downhill)
