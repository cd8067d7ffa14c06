"""Nonlinear least squares by Levenberg–Marquardt: one loop for all fits, plain or robust; and what its failures say."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from calib.finding import FindingKind
from calib.numerics.arrays import Bools, Floats, Ints
from calib.numerics.jit import compiled
from calib.refusal import RefusalError, Wording

_BLOCK = 128
_TINY = 1e-12


@dataclass(frozen=True)
class Quadratic:
    """Quadratic model of a cost at one point."""

    cost: float
    """−2 log likelihood; infinite for invalid parameters."""
    gradient: Floats
    """(P,): half the gradient."""
    information: Floats
    """(P, P): half the Gauss–Newton Hessian."""


Place = TypeVar("Place", bound=Quadratic)


@dataclass(frozen=True)
class Damping:
    """Schedule of the damping, which is relative to a Hessian scaled to unit diagonal."""

    first: float
    """At the beginning."""
    least: float
    """It stays above this."""
    most: float
    """Beyond it the minimisation ends."""
    growth: float
    """A failed step multiplies the damping by it."""
    relief: float
    """A successful step multiplies the damping by it."""
    acceleration: float = 1.0
    """Each further failure in a row multiplies the growth by it."""
    by_gain: bool = False
    """Whether a successful step multiplies by 1 − (2 ρ − 1)³ instead, but no less than the relief, where ρ is the ratio
    of actual to predicted gain (Nielsen; Madsen, Nielsen and Tingleff, Methods for non-linear least squares problems,
    2004, algorithm 3.16).
    """


NIELSEN = Damping(1e-4, 1e-9, 1e6, growth=4.0, relief=0.1, acceleration=2.0, by_gain=True)


def newton(at: Quadratic, free: Ints, damping: float) -> tuple[Floats, float, float]:
    """Return the damped Gauss–Newton step (P,) over the `free` columns.

    Also return Newton's decrement, the predicted gain of a full step, and the damping's contribution to it.
    """
    normal = at.information[free[:, None], free]
    scale = np.sqrt(normal.diagonal()) + _TINY
    damped = normal / (scale[:, None] * scale)
    damped.ravel()[:: len(free) + 1] += damping
    slope = at.gradient[free] / scale
    downhill = np.linalg.solve(damped, slope)
    step = np.zeros(len(at.gradient))
    step[free] = -downhill / scale
    return step, float(slope @ downhill), damping * float(downhill @ downhill)


def descend(
    at: Place,
    moved: Callable[[Place, Floats], Place],
    enough: Callable[[float, float], bool],
    damping: Damping,
    steps: int,
    *,
    free: Ints | None = None,
    least_gain: float = 0.0,
) -> Place:
    """Minimise over the `free` columns (all by default), in at most `steps` steps.

    `moved`: evaluates the point after a step (P,). Stops when `enough` of cost and decrement is true, or after a step
    that gains less than `least_gain` of the cost. Gauge directions, which do not change the cost, are harmless.
    """
    columns = np.arange(len(at.gradient)) if free is None else free
    level, growth = damping.first, damping.growth
    for _ in range(steps):
        step, decrement, damped = newton(at, columns, level)
        if not np.isfinite(at.cost) or enough(at.cost, decrement):
            break
        trial = moved(at, step)
        if trial.cost <= at.cost:
            gained = at.cost - trial.cost
            relief = 1 - (2 * gained / (decrement + damped) - 1) ** 3 if damping.by_gain else 0.0
            at, level, growth = trial, max(level * max(damping.relief, relief), damping.least), damping.growth
            if gained < least_gain * at.cost:
                break
        elif level > damping.most:
            break
        else:
            level, growth = level * growth, growth * damping.acceleration
    return at


@dataclass(frozen=True)
class Minimum(Quadratic):
    """A quadratic model with its `parameters` (P,)."""

    parameters: Floats


def minimise(
    evaluate: Callable[[Floats], tuple[Floats, Floats]],
    start: Floats,
    prior_sigma: Floats,
    *,
    robust: bool = True,
    damping: Damping = NIELSEN,
    converged: float = 0.0,
    least_gain: float = 1e-5,
    steps: int = 30,
) -> Minimum:
    """Minimise Σ ρ(r) + Σ (parameter / `prior_sigma`)² from `start` (P,).

    `evaluate` returns residuals (N, D) in units of a tolerance and their Jacobian (N, D, P), preferably in Fortran
    order; it may reuse the same arrays. ρ is |r|² of each match's D residuals or, if `robust`, 2 log(1 + |r|²),
    Cauchy's loss. `prior_sigma` is infinite for a parameter without a prior. Stops at a decrement below `converged` of
    the cost, or a gain below `least_gain` of it.
    """
    precision = prior_sigma**-2.0

    def at(parameters: Floats) -> Minimum:
        residual, jacobian = evaluate(parameters)
        square = np.sum(residual * residual, axis=1)
        loss = float(np.sum(2 * np.log(1 + square) if robust else square))
        loss += float(np.sum(precision * parameters**2))
        hessian, gradient = np.diag(precision), precision * parameters
        if not np.isfinite(loss):
            return Minimum(np.inf, gradient, hessian, parameters)
        weight = 2 / (1 + square) if robust else np.ones(len(square))
        _add_up(np.ascontiguousarray(jacobian.T), np.ascontiguousarray(residual.T), weight, hessian, gradient)
        return Minimum(loss, gradient, hessian, parameters)

    return descend(
        at(start),
        lambda place, step: at(place.parameters + step),
        lambda cost, decrement: decrement < converged * cost,
        damping,
        steps,
        least_gain=least_gain,
    )


@compiled
def _add_up(jacobian: Floats, residual: Floats, weight: Floats, hessian: Floats, gradient: Floats) -> None:
    """Add Σ weight row rowᵀ and Σ weight row residual, of (P, D, N), (D, N) and (N,): the normal equations."""
    size, dimensions, matches = jacobian.shape
    weighted = np.empty(_BLOCK)
    for d in range(dimensions):
        for first in range(0, matches, _BLOCK):
            block = slice(first, min(first + _BLOCK, matches))
            for p in range(size):
                row, size_of_row = jacobian[p, d, block], 0.0
                for k in range(len(row)):
                    weighted[k] = weight[first + k] * row[k]
                    size_of_row += np.abs(row[k])
                if size_of_row == 0.0:  # of what is known about one plane only
                    continue
                total = 0.0
                for k in range(len(row)):
                    total += weighted[k] * residual[d, first + k]
                gradient[p] += total
                for q in range(p + 1):
                    total, column = 0.0, jacobian[q, d, block]
                    for k in range(len(row)):
                        total += weighted[k] * column[k]
                    hessian[p, q] += total
    for p in range(size):
        for q in range(p):
            hessian[q, p] = hessian[p, q]


def covariance_of(information: Floats, free: Bools | Ints) -> Floats:
    """Invert the information on the free columns, (size, size); zero elsewhere."""
    covariance = np.zeros_like(information)
    chosen = np.ix_(free, free)
    covariance[chosen] = inverse_of(information[chosen])
    return covariance


def inverse_of(matrix: Floats) -> Floats:
    """Return the pseudo-inverse of a symmetric matrix (n, n) whose columns have very different scales."""
    scale = np.sqrt(np.diag(matrix))
    inverse: Floats = np.linalg.pinv(matrix / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    return inverse


NO_CORNER = FindingKind(
    "no-corner",
    "The matches determine no corner: those of a face lie on a line or in a few points.",
    "Show all three faces large and at different slants to both devices, and check that frames and patterns belong "
    "together.",
)


@contextmanager
def singular_refused(wording: Wording) -> Iterator[None]:
    """Turn equations without a solution, which follow from matches that are on no three planes, into RefusalError."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise RefusalError(
            NO_CORNER,
            f"The matches determine no corner ({error}): those of a face lie on a line or in a few points, or "
            f"{wording.unrelated}.",
            wording.move,
        ) from error
