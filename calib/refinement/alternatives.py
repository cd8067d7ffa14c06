"""A model with one parameter more, weighed against one without, by its evidence: an aspect of pixels that are not
square.

The covariance is that of the mixture of both: Bayesian model averaging (Hoeting et al. 1999, Statistical Science 14,
382). The larger model is followed to first order from the solution of the smaller one, without another fit.

The model of a corner has square pixels. A projector's picture that is 1 % wider than high is explained by walls that
are off square, with focal lengths that are wrong by a tenth and sigmas of a hundredth. So a second model, with an
aspect, is weighed against the first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.estimation import ROBUST_SIGMAS
from calib.numerics import Bools, Floats, covariance_of, huber_weights
from calib.refinement.likelihood import CornerFit, CornerProblem

_CENTRAL, _NEARLY_ALL = 0.6827, 0.9545  # one and two standard deviations of a normal distribution
_BISECTIONS = 50
_MOST = 100.0  # logarithm of a likelihood ratio: beyond, it is certain
# Pictures that are scaled in one direction, and remain so unnoticed: one in a hundred, by about 2 %.
_PROBABILITY, _SPREAD = 0.01, 0.02


@dataclass(frozen=True, eq=False)
class LargerModel:
    """A model with one parameter more, seen from the solution of the smaller one."""

    value: float
    """The parameter, less what it is in the smaller model."""
    sigma: float
    """Its standard deviation."""
    odds: float
    """Of this model over the smaller one."""
    response: Floats
    """(size,): change of the solution for a parameter of 1."""

    @property
    def probability(self) -> float:
        """If there is no third model."""
        return self.odds / (1 + self.odds)

    def added(self, probability: float) -> Floats:
        """What this model, of a `probability`, adds to the covariance (size, size) around the smaller's solution."""
        mean_square = self.value**2 + self.sigma**2
        return probability * mean_square * np.outer(self.response, self.response)


def averaged(covariance: Floats, models: Sequence[LargerModel]) -> Floats:
    """The covariance (size, size) over a model, whose own is given, and larger ones by their odds over it.

    Correlations are those of the mixture. A standard deviation is the half-width of the central 68 % around the
    model's solution, or half that of 95 % where that is more, as along a corner's valley: of a normal distribution it
    is its sigma, and what is less probable than one in twenty does not widen it.
    """
    shares = np.array([1.0, *(model.odds for model in models)])
    shares /= shares.sum()
    mixed = covariance + np.sum([model.added(share) for model, share in zip(models, shares[1:], strict=True)], axis=0)
    own = np.sqrt(covariance.diagonal())
    means = np.stack([np.zeros_like(own), *(model.value * model.response for model in models)])
    sigmas = np.stack([own, *(np.hypot(own, model.sigma * model.response) for model in models)])
    unknown = own > 0
    width = np.zeros_like(own)
    width[unknown] = np.maximum(
        _half_width(shares, means[:, unknown], sigmas[:, unknown], _CENTRAL),
        _half_width(shares, means[:, unknown], sigmas[:, unknown], _NEARLY_ALL) / 2,
    )
    scale = np.divide(width, np.sqrt(mixed.diagonal()), out=np.zeros_like(own), where=unknown)
    narrowed: Floats = scale[:, None] * mixed * scale
    return narrowed


def _half_width(shares: Floats, means: Floats, sigmas: Floats, probability: float) -> Floats:
    """Half-widths (Q,) of the intervals around 0 that hold a `probability` of mixtures of K normal distributions.

    `shares` (K,); `means` and `sigmas` (K, Q).
    """
    low: Floats = np.zeros(means.shape[1])
    high: Floats = np.max(np.abs(means) + 8 * sigmas, axis=0)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        inside = shares @ (
            scipy.special.ndtr((middle - means) / sigmas) - scipy.special.ndtr((-middle - means) / sigmas)
        )
        low, high = np.where(inside < probability, middle, low), np.where(inside < probability, high, middle)
    return high


def alternative(
    information: Floats, gradient: Floats, free: Bools, column: int, probability: float, spread: float
) -> LargerModel:
    """With a `column` besides those that are `free` (size,) in the smaller model.

    `information` (size, size) and `gradient` (size,): half the Hessian and half the gradient of the cost at its
    solution, with the parameter's Gaussian prior, of sigma `spread`. `probability`: of the larger model, beforehand.
    """
    every = free.copy()
    every[column] = True
    covariance = covariance_of(information, every)
    variance = float(covariance[column, column])
    value, sigma = float(-covariance[column] @ gradient), float(np.sqrt(variance))
    odds = probability * sigma / spread * float(np.exp(min(value**2 / variance / 2, _MOST)))
    return LargerModel(value, sigma, odds, np.where(free, covariance[column] / variance, 0.0))


def picture_scale(problem: CornerProblem, fit: CornerFit) -> LargerModel:
    """Weigh pixels of the projector that are not square, by their width over their height, less 1."""
    size = fit.state.size
    information, gradient = np.zeros((size + 1, size + 1)), np.zeros(size + 1)
    information[:size, :size], gradient[:size] = fit.information, fit.gradient
    information[size, size] = _SPREAD**-2.0
    for view, residual, variance in zip(problem.parts, fit.residuals, problem.variances, strict=True):
        predicted, jacobian, _ = view.predict(fit.state)
        by_aspect = predicted[:, 0] - fit.state.projector[1]
        deviation = np.linalg.norm(residual, axis=1) / np.sqrt(variance)
        weighted = huber_weights(deviation, ROBUST_SIGMAS) / variance * by_aspect
        gradient[size] += weighted @ residual[:, 0]
        information[size, size] += weighted @ by_aspect
        columns = view.columns(fit.state)
        np.add.at(information[size], columns, weighted @ jacobian[:, 0])
        information[columns, size] = information[size, columns]
    wider = alternative(information, gradient, np.append(problem.free, False), size, _PROBABILITY, _SPREAD)
    return replace(wider, response=wider.response[:size])
