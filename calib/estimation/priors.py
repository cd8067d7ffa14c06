"""Priors on parameters, column by column: Gaussian, heavy-tailed, or of one of several populations.

A heavy-tailed prior is a mixture of a narrow and a wide Gaussian. Of lenses and walls of which nothing is said, not
even the scale is known: they come from one of several populations, and the data tell which.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from calib.numerics import Floats, Ints, compiled

# One in twenty comes from the wide Gaussian, whose standard deviation is four times as large.
_ODD, _TIMES = 0.05, 4.0


@dataclass(frozen=True)
class ColumnPrior:
    """Prior on parameters: `mean`, `sigma` (size,); 0 = known, infinity = unknown.

    It is Gaussian, except for the columns that are `tailed`: few lenses and walls deviate strongly, but those few may
    do so by many sigmas. These are in arrays (n, d) of rows that deviate together.
    """

    mean: Floats
    sigma: Floats
    tailed: tuple[Ints, ...]

    @cached_property
    def root_precision(self) -> Floats:
        """1 / σ of the columns that are not known, 0 elsewhere, (size,)."""
        unknown = self.sigma > 0
        return np.where(unknown, 1.0 / np.where(unknown, self.sigma, 1.0), 0.0)

    def misfit(self, values: Floats) -> tuple[Floats, Floats, Floats]:
        """Return for each column (size,) its cost, half the gradient and half the (non-negative) curvature."""
        z = (values - self.mean) * self.root_precision
        cost, slope, curvature = z**2, z.copy(), np.ones_like(z)
        for columns in self.tailed:
            cost[columns], slope[columns], curvature[columns] = with_tails(z[columns])
        return cost, slope * self.root_precision, curvature * self.root_precision**2

    def knowing(self, columns: Sequence[int] | Ints) -> Self:
        """The prior with some columns fixed as known."""
        sigma = self.sigma.copy()
        sigma[list(columns)] = 0.0
        return replace(self, sigma=sigma)

    def without_tails(self, columns: Ints) -> Self:
        """The prior with some columns Gaussian."""
        rows = (row[~np.isin(row, columns).any(axis=1)] for row in self.tailed)
        return replace(self, tailed=tuple(row for row in rows if len(row)))


@compiled
def with_tails(z: Floats) -> tuple[Floats, Floats, Floats]:
    """Return −2 log of a mixture of a Gaussian of sigma 1 and a wide one, 0 at its peak, for deviations (n, d).

    The d deviations of a row come from the same Gaussian: where one wall of a corner is far off, the others may be too.
    The cost (n, d) of a row is shared out evenly. Also return half its derivative, and half its second derivatives or
    that of the wide Gaussian if larger, both (n, d). The prior is nearly Gaussian up to three sigmas;
    beyond, the data outweigh it.
    """
    cost, slope, curvature = np.empty(z.shape), np.empty(z.shape), np.empty(z.shape)
    size, least = z.shape[1], 1.0 / (_TIMES * _TIMES)
    odds = _ODD / (1.0 - _ODD) / _TIMES**size  # of the wide Gaussian, at the peak
    for i in range(len(z)):
        square = 0.0
        for j in range(size):
            square += z[i, j] * z[i, j]
        # Relative to the wide Gaussian, whose density does not underflow.
        usual = np.exp(-0.5 * (1.0 - least) * square) / odds
        share = 1.0 / (1.0 + usual)  # the probability of belonging to the wide Gaussian
        weight = 1.0 - share * (1.0 - least)
        for j in range(size):
            cost[i, j] = (least * square - 2.0 * np.log((1.0 + usual) / (1.0 + 1.0 / odds))) / size
            slope[i, j] = weight * z[i, j]
            curved = weight - share * (1.0 - share) * (z[i, j] * (1.0 - least)) ** 2
            curvature[i, j] = max(curved, least)
    return cost, slope, curvature


@dataclass(frozen=True, eq=False)
class Population:
    """Columns that deviate by one common scale, which is not known."""

    columns: Ints
    """(d,): their indices."""
    sigmas: Floats
    """(K,): standard deviations in the populations from which they may come."""
    shares: Floats
    """(K,): how common these are."""

    @classmethod
    def of(cls, columns: Ints, populations: Sequence[tuple[float, float]]) -> "Population":
        """Of populations, each with its standard deviation and its share."""
        sigmas, shares = np.array(populations).T
        return cls(columns, sigmas, shares)
