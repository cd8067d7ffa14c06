"""Variance components of the residuals: independent noise, systematic error per cell, and long-wave errors."""

from dataclasses import dataclass

import numpy as np
import scipy

from calib.numerics import CUBIC, MEDIAN_LENGTH, Floats, median, orthonormal_polynomials
from calib.refinement.match_cells import Cells

_SIGNIFICANT = 0.99
_LEAST_CELLS = 3 * CUBIC  # on a plane, to separate long waves from short ones


@dataclass(frozen=True)
class Noise:
    """Noise of one capture: the scatter of a match; τ, the systematic error of a cell's mean; the root mean square of
    the residuals' long waves; κ, their overdispersion: their variance over that expected from independent cells.

    Only long waves move the parameters, so κ is the factor by which their variances grow. `repeats`: number of captures
    taken from the same place. They have the same smooth errors, so together they count as one.
    """

    match_px: float
    systematic_px: float
    smooth_px: float
    inflation: float
    repeats: int = 1

    def variances(self, cells: Cells) -> Floats:
        """κ (σ² + τ²) of each coordinate of each cell, (M,), times the repeats."""
        return self.repeats * self.inflation * _independent(cells, self.systematic_px)


def noise_of(cells: Cells, residual: Floats, absorbed: float) -> Noise:
    """Estimate the noise from residuals (M, 2) of a fit that absorbed `absorbed` degrees of freedom of this capture."""
    systematic_px = _systematic(residual / cells.coarseness[:, None], cells.sigma_px / cells.coarseness)
    independent = _independent(cells, systematic_px)
    return Noise(cells.noise_px, systematic_px, *_long_waves(cells, residual, independent, absorbed))


def _independent(cells: Cells, systematic_px: float) -> Floats:
    return cells.sigma_px**2 + (systematic_px * cells.coarseness) ** 2


def _systematic(residual: Floats, sigma_px: Floats) -> float:
    """Return τ in px such that the median size of the residuals (M, 2) matches the variances σ² + τ² (robust)."""
    size, variance = np.linalg.norm(residual, axis=1), sigma_px**2
    low, high = 0.0, 2 * float(np.median(size)) + 1e-12
    for _ in range(50):
        middle = (low + high) / 2
        relative = size / np.sqrt(variance + middle**2)
        low, high = (middle, high) if median(relative) > MEDIAN_LENGTH else (low, middle)
    return high if high > 1e-3 * float(np.median(sigma_px)) else 0.0


def long_waves(cells: Cells, residual: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Project the residuals of each plane on cubic polynomials over it: χ² (P,), with 2 CUBIC degrees of freedom, and
    sum of squares (P,) in px², ordered by label; NaN for a plane with too few cells.
    """
    totals, squares = [], []
    for plane in np.unique(cells.plane):
        members = cells.plane == plane
        if members.sum() < _LEAST_CELLS:
            totals.append(np.nan)
            squares.append(np.nan)
            continue
        root = 1 / np.sqrt(variance[members])
        waves = orthonormal_polynomials(cells.camera_px[members], root)
        amplitudes = waves.T @ (residual[members] * root[:, None])
        totals.append(float(np.sum(amplitudes**2)))
        squares.append(float(np.sum((waves @ amplitudes / root[:, None]) ** 2)))
    return np.array(totals), np.array(squares)


def overdispersion(total: float, freedom: float, significant: float = _SIGNIFICANT) -> float:
    """Return κ, χ² over its degrees of freedom; 1 if it is not significant."""
    return 1.0 if freedom <= 0 or total < scipy.special.chdtri(freedom, 1 - significant) else total / freedom


def _long_waves(cells: Cells, residual: Floats, variance: Floats, absorbed: float) -> tuple[float, float]:
    """Return the root mean square, in px, of the residuals' projection on cubic polynomials over each plane, and κ."""
    totals, squares = long_waves(cells, residual, variance)
    freedom = 2 * CUBIC * np.count_nonzero(np.isfinite(totals)) - absorbed
    return float(np.sqrt(np.nansum(squares) / len(cells))), overdispersion(float(np.nansum(totals)), freedom)
