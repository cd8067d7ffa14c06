"""A model with one parameter more, weighed against one without, by its evidence.

The covariance is that of the mixture of both: Bayesian model averaging (Hoeting et al. 1999, Statistical Science 14,
382). The larger model is followed to first order from the solution of the smaller one, without another fit.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats
from calib.refinement.profile_likelihood import covariance_of

_MOST = 100.0  # logarithm of a likelihood ratio: beyond, it is certain


@dataclass(frozen=True, eq=False)
class Alternative:
    """The further parameter's `value`, less that in the smaller model, with its `sigma`. `odds` of the larger model
    over the smaller one. `response` (size,): change of the solution for a parameter of 1.
    """

    value: float
    sigma: float
    odds: float
    response: Floats

    def added(self, probability: float) -> Floats:
        """What this model, of a `probability`, adds to the covariance (size, size) around the smaller's solution."""
        mean_square = self.value**2 + self.sigma**2
        return probability * mean_square * np.outer(self.response, self.response)


def alternative(
    information: Floats, gradient: Floats, free: Bools, column: int, probability: float, spread: float
) -> Alternative:
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
    return Alternative(value, sigma, odds, np.where(free, covariance[column] / variance, 0.0))
