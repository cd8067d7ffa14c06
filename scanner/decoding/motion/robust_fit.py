"""Robust linear least squares with Huber's weights."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Floats, median
from scanner.decoding.significance import HUBER_ROUNDS, HUBER_SIGMAS


@dataclass(frozen=True)
class RobustFit:
    """Unknowns that were `found` (U,), with the `inverse` normal matrix (U, U).

    `left` (M,): residuals, with their `weight` (M,) and robust standard deviation `scale`.
    """

    found: Floats
    inverse: Floats
    left: Floats
    weight: Floats
    scale: float

    def cost(self, scale: float) -> float:
        """Return −2 log likelihood for this standard deviation, with the Huber loss for outliers."""
        off = np.abs(self.left) / scale
        return float(np.sum(np.where(off < HUBER_SIGMAS, off**2, HUBER_SIGMAS * (2 * off - HUBER_SIGMAS))))


def robust_fit(design: Floats, seen: Floats, expected: Floats | float = 0.0) -> RobustFit:
    """Fit the unknowns to `seen` (M,) = found @ `design` (U, M).

    `expected`: inverse of their prior covariance (U, U), relative to the variance of what is seen.
    """
    weight: Floats = np.ones(len(seen))
    for _ in range(HUBER_ROUNDS):
        weighted = design * weight
        inverse: Floats = np.asarray(np.linalg.pinv(weighted @ design.T + expected, hermitian=True), np.float64)
        found = inverse @ (weighted @ seen)
        left = seen - found @ design
        scale = SIGMA_PER_MEDIAN * median(np.abs(left)) * len(seen) / max(len(seen) - len(design), 1)
        weight = np.minimum(1.0, HUBER_SIGMAS * scale / np.maximum(np.abs(left), 1e-9))
    return RobustFit(found, inverse, left, weight, scale)
