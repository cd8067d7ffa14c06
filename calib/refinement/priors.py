"""Priors on parameters: on distortion terms, on columns one by one, and on a rig from other data.

No distortion term is exactly zero. Omitting a term that is just too small to detect makes the sigmas of all other
parameters wrong; with a prior, its uncertainty is kept. docs/method.md gives the origin of the standard deviations. A
column's prior is Gaussian, or heavy-tailed, a mixture of a narrow and a wide Gaussian. Of lenses and walls of which
nothing is said, not even the scale is known: they come from one of several populations, and the data tell which
(`scale_mixture.py`).

What other data say of a rig is the quadratic approximation around the most likely state, which replaces those data. It
is exact as far as their likelihood is quadratic within a few sigmas, which holds for boards but not for a single
corner.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from calib.geometry import cross_matrix, tangent_basis
from calib.numerics import Floats, Ints, compiled
from calib.refinement.parameters import ROTATION, SHARED, TRANSLATION, State

# One in twenty comes from the wide Gaussian, whose standard deviation is four times as large.
_ODD, _TIMES = 0.05, 4.0
DECENTERING = 3e-4  # standard deviation of p1 and p2
# The same of populations, and how common they are: published |p| spread over the decades from 0.00002 (machine vision)
# to 0.005 (wide and consumer lenses). docs/method.md names some.
DECENTERINGS = (1e-4, 0.3), (3e-4, 0.4), (1e-3, 0.2), (3e-3, 0.1)
THIRD_RADIAL = 0.01  # of k3
RADIAL = 0.1, 0.03  # of k1, k2
_POWERS = 2, 4, 0, 0, 6  # the image depends on k1 / f², k2 / f⁴, k3 / f⁶; the prior on p1 and p2 is on the numbers
# Smallest sigma of any parameter: log focal, pixels, lens terms, radians and directions.
_LEAST_OF_DEVICE = (1e-6, 1e-3, 1e-3, 1e-5, 1e-5, 1e-6, 1e-6, 1e-5)
_LEAST = np.array([*_LEAST_OF_DEVICE, *_LEAST_OF_DEVICE, *[1e-7] * 5])


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


@dataclass(frozen=True)
class PrincipalPoint:
    """Prior on a principal point: `px` (x, y) with a standard deviation; 0 means exactly known."""

    px: tuple[float, float]
    sigma_px: float


@dataclass(frozen=True)
class LensPrior:
    """Prior of one device: `mean` and standard deviation `sigma` of k1, k2, p1, p2, k3, all independent.

    A sigma of 0 marks terms that a lens does not have: these stay zero. `point`: a projector's principal point; None
    if no more is known of it than of any device's. A camera's is given separately. `decenterings`: standard deviations
    of p1 and p2 in the populations that the lens may come from, with their shares; none if `sigma` is theirs.
    """

    mean: tuple[float, ...] = (0.0,) * 5
    sigma: tuple[float, ...] = (*RADIAL, DECENTERING, DECENTERING, THIRD_RADIAL)
    point: PrincipalPoint | None = None
    decenterings: tuple[tuple[float, float], ...] = DECENTERINGS

    @property
    def powers(self) -> tuple[int, ...]:
        """Power of the focal length with which each term scales at equal image distortion; 0 for measured lenses."""
        return _POWERS if not any(self.mean) else (0,) * len(_POWERS)

    @property
    def bends(self) -> bool:
        """Whether the lens may have a first radial term."""
        return self.sigma[0] > 0 or self.mean[0] != 0

    def with_sigmas(
        self, decentering: float | None = None, k3: float | None = None, radial: float | None = None
    ) -> "LensPrior":
        """Return a copy with another standard deviation of p1 and p2, of k3, or of k1 and k2, where given."""
        k1, k2, p1, p2, third = self.sigma
        tangential = (p1, p2) if decentering is None else (decentering, decentering)
        populations = self.decenterings if decentering is None else ()
        first, second = (k1, k2) if radial is None else (radial, radial)
        sigma = first, second, *tangential, third if k3 is None else k3
        return replace(self, sigma=sigma, decenterings=populations)


ORDINARY_LENSES = LensPrior(), LensPrior()


@dataclass(frozen=True)
class KnownRig:
    """The most likely `state` (its corners are ignored) and the `covariance` (21, 21) of the shared columns."""

    state: State
    covariance: Floats

    @cached_property
    def safe_covariance(self) -> Floats:
        """The covariance, made invertible where a column was held fixed."""
        return self.covariance + np.diag(_LEAST**2)

    @cached_property
    def precision(self) -> Floats:
        """Inverse of the covariance, (21, 21)."""
        scale = np.sqrt(self.safe_covariance.diagonal())
        inverse: Floats = np.linalg.inv(self.safe_covariance / np.outer(scale, scale)) / np.outer(scale, scale)
        return inverse

    def step_to(self, state: State) -> Floats:
        """Return the step (21,) from the known state to `state`."""
        return replace(self.state.rig, off_square=state.off_square, corners=state.corners).step_to(state)[:SHARED]

    def linearised(self, state: State) -> tuple[Floats, Floats]:
        """The step (21,) from the known state to a state, and its derivatives (21, 21) by the state's columns."""
        step = self.step_to(state)
        by_columns = np.eye(SHARED)
        # Derivative of log(exp[δ] R) by δ: the inverse of the left Jacobian of SO(3), to second order.
        turn = cross_matrix(step[ROTATION])
        by_columns[ROTATION, ROTATION] -= turn / 2 - turn @ turn / 12
        known, own = (tangent_basis(pose.translation) for pose in (self.state.pose, state.pose))
        by_columns[TRANSLATION, TRANSLATION] = known.T @ own
        return step, by_columns

    def misfit(self, state: State) -> tuple[float, Floats, Floats]:
        """Return the cost of a state, half its gradient (21,) and half its Hessian (21, 21) in the state's columns."""
        step, by_columns = self.linearised(state)
        pull = self.precision @ step
        return float(step @ pull), by_columns.T @ pull, by_columns.T @ self.precision @ by_columns
