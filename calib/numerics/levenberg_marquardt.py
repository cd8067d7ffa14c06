"""Nonlinear least squares that stray residuals do not sway."""

from collections.abc import Callable

import numpy as np

from calib.numerics.array_types import Floats
from calib.numerics.jit import compiled

_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-9, 1e6
_FIRST_GROWTH, _MOST_RELIEF = 4.0, 0.1
_BLOCK = 128
_LEAST_GAIN = 1e-5


def minimise(
    evaluate: Callable[[Floats], tuple[Floats, Floats]], start: Floats, prior_sigma: Floats, steps: int = 30
) -> tuple[Floats, float]:
    """Minimise Σ log(1 + |r|²) + ½ Σ (parameter / `prior_sigma`)² from `start` (P,): the parameters and that sum.

    `evaluate` gives residuals (N, D) in units of a tolerance and their Jacobian (N, D, P), best in Fortran's order, if
    it likes in the same arrays every time. The first sum is Cauchy's robust loss of each match's D residuals.
    `prior_sigma` is infinite for a parameter that has no prior. Levenberg and Marquardt's method, so directions that
    change nothing (a gauge) are no harm; how the damping follows the gain is Nielsen's (Madsen, Nielsen and Tingleff,
    Methods for non-linear least squares problems, 2004, algorithm 3.16).
    """
    precision = prior_sigma**-2.0
    current, damping = start, _FIRST_DAMPING
    residual, jacobian = evaluate(current)
    cost = _cost(residual, current, precision)
    for _ in range(steps):
        hessian, gradient = _normal_equations(residual, jacobian)
        hessian += np.diag(precision)
        gradient += precision * current
        scale = np.sqrt(np.diag(hessian) + 1e-12)
        hessian /= scale[:, None] * scale
        gradient /= scale
        gained, growth = 0.0, _FIRST_GROWTH
        while damping < _MOST_DAMPING:
            step = np.linalg.solve(hessian + damping * np.eye(len(current)), gradient)
            trial = current - step / scale
            residual, jacobian = evaluate(trial)
            trial_cost = _cost(residual, trial, precision)
            if trial_cost < cost:
                gained = cost - trial_cost
                ratio = gained / float(gradient @ step - 0.5 * step @ hessian @ step)  # to what the step foresaw
                current, cost = trial, trial_cost
                damping = max(damping * max(_MOST_RELIEF, 1 - (2 * ratio - 1) ** 3), _LEAST_DAMPING)
                break
            damping *= growth
            growth *= 2
        if gained < _LEAST_GAIN * cost:
            break
    return current, cost


def _cost(residual: Floats, parameters: Floats, precision: Floats) -> float:
    loss = float(np.sum(np.log(1 + np.sum(residual * residual, axis=1))))
    return loss + 0.5 * float(np.sum(precision * parameters**2)) if np.isfinite(loss) else np.inf


def _normal_equations(residual: Floats, jacobian: Floats) -> tuple[Floats, Floats]:
    """The Gauss–Newton Hessian (P, P) and the gradient (P,) of Cauchy's loss."""
    size = jacobian.shape[2]
    hessian, gradient = np.zeros((size, size)), np.zeros(size)
    # Half the gradient's and half the Hessian's factor two cancel in the step.
    weight = 2 / (1 + np.sum(residual * residual, axis=1))
    _add_up(np.ascontiguousarray(jacobian.T), np.ascontiguousarray(residual.T), weight, hessian, gradient)
    return hessian, gradient


@compiled
def _add_up(jacobian: Floats, residual: Floats, weight: Floats, hessian: Floats, gradient: Floats) -> None:
    """Σ weight row rowᵀ and Σ weight row residual, of (P, D, N), (D, N) and (N,)."""
    size, dimensions, matches = jacobian.shape
    weighted = np.empty(_BLOCK)
    for d in range(dimensions):
        for first in range(0, matches, _BLOCK):
            block = slice(first, min(first + _BLOCK, matches))
            for p in range(size):
                row, some = jacobian[p, d, block], 0.0
                for k in range(len(row)):
                    weighted[k] = weight[first + k] * row[k]
                    some += np.abs(row[k])
                if some == 0.0:  # of what is known about one plane only
                    continue
                total = 0.0
                for k in range(len(row)):
                    total += weighted[k] * residual[d, first + k]
                gradient[p] += total
                for q in range(p + 1):
                    total, other = 0.0, jacobian[q, d, block]
                    for k in range(len(row)):
                        total += weighted[k] * other[k]
                    hessian[p, q] += total
    for p in range(size):
        for q in range(p):
            hessian[q, p] = hessian[p, q]
