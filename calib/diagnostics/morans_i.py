"""Test residuals for spatial autocorrelation over the image: Moran's I, and the size of the shared error.

P. A. P. Moran, Notes on continuous stochastic phenomena, Biometrika 37 (1950); the moments under independence are those
of Cliff and Ord, Spatial Processes (1981), chapter 2.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats

_FEWEST_IN_CELL = 3
_FEWEST_PAIRS = 20
# One-sided: a false alarm rate of one in a thousand for independent residuals.
_SIGNIFICANT_SIGMAS = 3.09
# A pattern this small a share of the variance is found in hundreds of thousands of residuals, and changes nothing.
_NEGLIGIBLE = 0.02


@dataclass(frozen=True)
class SpatialCorrelation:
    """Autocorrelation of residuals over an image, by square cells of `cell_px`.

    `correlation`: Moran's I of the cells' means with their neighbours; `expected` ± `sigma`: its distribution for
    independent residuals. `total_px`: root mean square of the residuals; `shared_px`: of the part that neighbouring
    cells share.
    """

    cell_px: float
    correlation: float
    expected: float
    sigma: float
    total_px: float
    shared_px: float

    @property
    def significant(self) -> bool:
        """Whether the correlation of neighbours is significant."""
        return self.correlation > self.expected + _SIGNIFICANT_SIGMAS * self.sigma

    @property
    def shared_variance(self) -> float:
        """Share of the variance that neighbours have in common, 0 … 1."""
        return (self.shared_px / self.total_px) ** 2 if self.total_px > 0 else 0.0

    @property
    def structured(self) -> bool:
        """Whether the pattern is significant and more than a negligible share of the variance."""
        return self.significant and self.shared_variance > _NEGLIGIBLE


def spatial_correlation(pixel: Floats, residual_px: Floats, cell_px: float) -> SpatialCorrelation | None:
    """Test residuals (N,), or (N, 2) of two coordinates, at pixels (N, 2); None if too few cells have neighbours.

    Independent errors cancel in the mean product of neighbouring cells' means, so its root is the size of the shared
    part.
    """
    if not len(pixel):
        return None
    columns = residual_px.reshape(len(residual_px), -1)
    place = np.floor((pixel - pixel.min(axis=0)) / cell_px).astype(np.int64)
    shape = tuple(place.max(axis=0)[::-1] + 1)
    cell = place[:, 1] * shape[1] + place[:, 0]
    size = shape[0] * shape[1]
    count = np.bincount(cell, minlength=size)
    filled = (count >= _FEWEST_IN_CELL).reshape(shape)
    pairs = int(_products(filled))
    if pairs < _FEWEST_PAIRS:
        return None
    means = [(np.bincount(cell, column, size) / np.maximum(count, 1)).reshape(shape) for column in columns.T]
    expected, sigma = _moments(filled, pairs)
    correlations = [_moran(mean, filled, pairs) for mean in means]
    shared = sum(max(0.0, _mean_product(mean, filled, pairs)) for mean in means)
    return SpatialCorrelation(
        cell_px,
        float(np.mean(correlations)),
        expected,
        sigma / float(np.sqrt(len(means))),
        float(np.sqrt(np.mean(np.sum(columns**2, axis=1)))),
        float(np.sqrt(shared)),
    )


def _mean_product(mean: Floats, filled: Bools, pairs: int) -> float:
    """Of neighbouring cells' means, around zero: a shift that all of them share is structure as well."""
    return _products(np.where(filled, mean, 0.0)) / pairs


def _products(value: Floats | Bools) -> float:
    """Sum over pairs of neighbouring cells, each pair once."""
    return float((value[:, 1:] * value[:, :-1]).sum() + (value[1:] * value[:-1]).sum())


def _moran(mean: Floats, filled: Bools, pairs: int) -> float:
    """I = (n / W) Σ w z z' / Σ z², z from the mean of all cells; every pair of neighbours counts both ways."""
    value = np.where(filled, mean - mean[filled].mean(), 0.0)
    squares = float((value**2).sum())
    return float(filled.sum() / pairs * _products(value) / squares) if squares > 0 else 0.0


def _moments(filled: Bools, pairs: int) -> tuple[float, float]:
    """Expectation and standard deviation of I for independent normal values."""
    n, s0 = int(filled.sum()), 2.0 * pairs
    neighbours = np.zeros(filled.shape)
    across, down = filled[:, 1:] & filled[:, :-1], filled[1:] & filled[:-1]
    neighbours[:, 1:] += across
    neighbours[:, :-1] += across
    neighbours[1:] += down
    neighbours[:-1] += down
    s1, s2 = 2.0 * s0, float(4 * (neighbours**2).sum())
    expected = -1 / (n - 1)
    square = (n * n * s1 - n * s2 + 3 * s0 * s0) / ((n * n - 1) * s0 * s0)
    return expected, float(np.sqrt(max(square - expected**2, 0.0)))
