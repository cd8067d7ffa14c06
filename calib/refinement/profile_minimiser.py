"""Minimise the cost along the profile of the camera's focal length."""

import numpy as np

from calib.numerics import newton
from calib.refinement.likelihood import CornerFit, CornerProblem
from calib.refinement.parameters import CAMERA, State

CONVERGED = 1e-3  # in cost: a thirtieth of a sigma
_STEPS = 40
_LONGEST_STEP = 0.1  # of log f
_HALVINGS = 4
# Largest predicted decrease, as a share of the cost, at which a fit is given up that would stay above the ceiling; and
# the same where it would stay that many times above it. Most steps of a sweep are taken where nothing fits.
_SLOW, _SLOW_IF_FAR, _FAR = 0.1, 0.5, 10.0


def minimise(
    problem: CornerProblem, state: State, *, tolerance: float = CONVERGED, ceiling: float = np.inf
) -> CornerFit:
    """Find the nearest minimum by descending the profile along the camera's focal length.

    Stops when the predicted decrease of the cost is below `tolerance`, or when the cost would stay above `ceiling`.

    The valley is curved: a long joint step leaves it, and a series of short ones looks like convergence. So after each
    joint Newton step everything but the focal is relaxed back to the valley's floor, along which the cost is nearly a
    parabola.
    """
    anchored, free = problem.holding(CAMERA.start), np.flatnonzero(problem.free)
    fit = relax(anchored, state, tolerance=tolerance)
    for _ in range(_STEPS):
        step, decrement, _ = newton(fit, free, problem.damping.least)
        if not np.isfinite(fit.cost) or decrement < tolerance or fit.cost - decrement > ceiling:
            break
        step *= min(1.0, _LONGEST_STEP / max(abs(step[CAMERA.start]), 1e-12))
        for _ in range(_HALVINGS):
            trial = relax(anchored, fit.state.moved(step), tolerance=tolerance)
            if trial.cost <= fit.cost:
                break
            step /= 4
        else:
            break
        fit = trial
    return fit


def relax(
    problem: CornerProblem,
    state: State,
    *,
    tolerance: float = CONVERGED,
    steps: int = _STEPS,
    ceiling: float = np.inf,
) -> CornerFit:
    """Minimise over the free columns of the problem by Levenberg–Marquardt.

    Stops when Newton's decrement, the predicted decrease of a full step, falls below `tolerance`, or below that share
    of a hundredth of the cost; or when the cost decreases slowly, compared with how far above `ceiling` it would stay.
    """

    def enough(cost: float, decrement: float) -> bool:
        remaining = cost - decrement
        hopeless = remaining > ceiling and decrement < (_SLOW_IF_FAR if remaining > _FAR * ceiling else _SLOW) * cost
        return hopeless or decrement < tolerance * (1 + 0.01 * cost)

    return problem.minimise(state, steps=steps, enough=enough)
