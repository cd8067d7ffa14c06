"""Robust linear least squares with Huber's weights."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.numerics import Floats, Ints, reweighted, robust_sigma
from scanner.decoding.significance import HUBER_ROUNDS, HUBER_SIGMAS


@dataclass(frozen=True)
class RobustFit:
    """Unknowns `found` (U,) from what was `seen` (M,) = found @ `design` (U, M), with robust weights (M,)."""

    design: Floats
    seen: Floats
    found: Floats
    weight: Floats

    @cached_property
    def left(self) -> Floats:
        """(M,): the residuals."""
        return self.seen - self.found @ self.design

    @cached_property
    def scale(self) -> float:
        """Robust standard deviation of the residuals."""
        return _scale(self.left, len(self.found))

    @cached_property
    def inverse(self) -> Floats:
        """(U, U): inverse normal matrix."""
        return np.asarray(np.linalg.pinv((self.design * self.weight) @ self.design.T, hermitian=True), np.float64)

    @property
    def gained(self) -> float:
        """Decrease of χ²."""
        return float(np.sum(self.weight * (self.seen**2 - self.left**2))) / self.scale**2

    def covariance(self, group: Ints) -> Floats:
        """Return the covariance (U, U), with errors that are correlated within a `group` (M,)."""
        scores = self.design * (self.weight * self.left)
        sums = np.stack([np.bincount(group, of_unknown) for of_unknown in scores])
        return self.inverse @ (sums @ sums.T) @ self.inverse + self.inverse * self.scale**2

    def cost(self, scale: float) -> float:
        """Return −2 log likelihood for this standard deviation, with the Huber loss for outliers."""
        off = np.abs(self.left) / scale
        return float(np.sum(np.where(off < HUBER_SIGMAS, off**2, HUBER_SIGMAS * (2 * off - HUBER_SIGMAS))))


def robust_fit(design: Floats, seen: Floats) -> RobustFit:
    """Fit the unknowns to `seen` (M,) = found @ `design` (U, M)."""

    def weigh(left: Floats) -> Floats:
        return np.minimum(1.0, HUBER_SIGMAS * _scale(left, len(design)) / np.maximum(np.abs(left), 1e-9))

    found = reweighted(design, seen, weigh, np.ones(len(seen)), HUBER_ROUNDS)
    return RobustFit(design, seen, found, weigh(seen - found @ design))


def _scale(left: Floats, unknowns: int) -> float:
    return robust_sigma(left) * len(left) / max(len(left) - unknowns, 1)
