"""Nonlinear least squares that stray residuals do not sway."""

from collections.abc import Callable

import numpy as np

from calib.arrays import Floats

_FIRST_DAMPING = 1e-4
_LEAST_GAIN = 1e-5


def minimise(
    evaluate: Callable[[Floats], tuple[Floats, Floats]], start: Floats, prior_sigma: Floats, steps: int = 30
) -> tuple[Floats, float]:
    """Minimise Σ log(1 + |r|²) + ½ Σ (parameter / `prior_sigma`)² from `start` (P,): the parameters and that sum.

    `evaluate` gives residuals (N, D) in units of a tolerance and their Jacobian (N, D, P). The first sum is Cauchy's
    robust loss of each match's D residuals. `prior_sigma` is infinite for a parameter that has no prior. Levenberg
    and Marquardt's method, so directions that change nothing (a gauge) are no harm.
    """
    precision = prior_sigma**-2.0
    current, damping = start, _FIRST_DAMPING
    residual, jacobian = evaluate(current)
    cost = _cost(residual, current, precision)
    for _ in range(steps):
        weight = 1 / (1 + np.sum(residual**2, axis=1))
        weighted = jacobian * weight[:, None, None]
        flat = jacobian.reshape(-1, len(current))
        # Half the gradient's and half the Gauss–Newton Hessian's factor two cancel in the step.
        hessian = 2 * weighted.reshape(-1, len(current)).T @ flat + np.diag(precision)
        gradient = 2 * np.einsum("ndp,nd->p", weighted, residual) + precision * current
        scale = np.sqrt(np.diag(hessian) + 1e-12)
        hessian /= scale[:, None] * scale
        gained = 0.0
        while damping < 1e6:
            trial = current - np.linalg.solve(hessian + damping * np.eye(len(current)), gradient / scale) / scale
            trial_residual, trial_jacobian = evaluate(trial)
            trial_cost = _cost(trial_residual, trial, precision)
            if trial_cost < cost:
                gained = cost - trial_cost
                current, residual, jacobian, cost = trial, trial_residual, trial_jacobian, trial_cost
                damping = max(damping / 10, 1e-9)
                break
            damping *= 10
        if gained < _LEAST_GAIN * cost:
            break
    return current, cost


def _cost(residual: Floats, parameters: Floats, precision: Floats) -> float:
    loss = float(np.sum(np.log1p(np.sum(residual**2, axis=1))))
    return loss + 0.5 * float(np.sum(precision * parameters**2)) if np.isfinite(loss) else np.inf
