"""Errors that neighbours share: Moran's I of residuals, smooth errors of matches, the form of a face that is not flat.

P. A. P. Moran, Notes on continuous stochastic phenomena, Biometrika 37 (1950); the moments under independence are those
of Cliff and Ord, Spatial Processes (1981), chapter 2.

Averaging over a surface does not remove smooth errors. Response curves and interreflection cause them. Across the
epipolar lines they show in the rays' misses; along them, where they change the depth, the same size is assumed.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import (
    CUBIC,
    Bools,
    Floats,
    Ints,
    biweight,
    biweight_slope,
    clustered_scatter,
    influence_on,
    monomials,
    orthonormal,
    orthonormal_polynomials,
    robust_covariance,
)
from calib.pointcloud import FittedPlane, Sphere

_FEWEST_IN_CELL = 3
_FEWEST_PAIRS = 20
# One-sided: a false alarm rate of one in a thousand for independent residuals.
_SIGNIFICANT_SIGMAS = 3.09
# A pattern this small a share of the variance is found in hundreds of thousands of residuals, and changes nothing.
_NEGLIGIBLE = 0.02


@dataclass(frozen=True)
class SpatialCorrelation:
    """Autocorrelation of residuals over an image, by square cells."""

    cell_px: float
    """Side of a cell."""
    correlation: float
    """Moran's I of the cells' means with their neighbours."""
    expected: float
    """Mean of its distribution for independent residuals."""
    sigma: float
    """Standard deviation of that distribution."""
    total_px: float
    """Root mean square of the residuals."""
    shared_px: float
    """The same of the part that neighbouring cells share."""

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


# Variance of a camera pixel's footprint along rows and along columns: the pixel, and a blur of half a pixel.
_FOOTPRINT_PX2 = 1 / 12 + 1 / 4
# Measured share of the footprint's effect on a sphere that the decoder does not correct.
_LEFT = 0.4
_RIM = 0.97  # limit of r² / R², to stay away from the rim, where the approximation fails
_LINEAR = 3  # constant and linear terms, which a calibration absorbs first


def smooth_modes(pixel: Floats) -> Floats:
    """Polynomials up to the cubic over pixels (N, 2), orthonormal in the mean over them, lowest first: (N, ≤ 10)."""
    modes: Floats = np.sqrt(len(pixel)) * orthonormal_polynomials(pixel)
    return modes


def smooth_error_px(residual_px: Floats, modes: Floats, cluster: Ints) -> float:
    """Standard deviation of the amplitude of each mode (N, K) in the rays' misses (N,), in pixels.

    Measured on the quadratic and cubic modes, and assumed for all, because a calibration absorbs the lower ones. With
    few amplitudes the variance is enlarged by n / (n − 2), as for Student's t. The part of errors that correlate only
    within a `cluster` (N,) is subtracted.
    """
    finite = np.where(np.isfinite(residual_px), residual_px, 0.0)
    from_median = finite - np.median(finite)
    weight, slope = biweight(from_median), biweight_slope(from_median)
    scores = (weight * finite)[:, None] * modes[:, _LINEAR:] / max(slope.sum(), 1.0)
    count = scores.shape[1]
    excess = np.sum(scores.sum(axis=0) ** 2) - np.trace(clustered_scatter(scores, cluster))
    return float(np.sqrt(max(excess, 0.0) / max(count - 2, 1)))


def footprint_offsets(sphere: Sphere, points: Floats, focal_px: float) -> Floats:
    """Distances (N,) of points (N, 3) of a sphere behind its surface, because a pixel averages over its footprint.

    Along the ray the offset is ½ σ² ∇²z with z = −√(R² − r²), r the ray's distance from the centre.
    """
    distance = np.linalg.norm(points, axis=1)
    rays = points / distance[:, None]
    along = rays @ sphere.centre
    r2 = np.minimum(sphere.centre @ sphere.centre - along**2, _RIM * sphere.radius**2)
    along_ray2 = sphere.radius**2 - r2
    behind = (
        0.5 * _LEFT * _FOOTPRINT_PX2 * (distance / focal_px) ** 2 * (sphere.radius**2 + along_ray2) / along_ray2**1.5
    )
    outwards: Floats = behind * np.sqrt(along_ray2) / sphere.radius
    return outwards


@dataclass(frozen=True)
class PlaneForm:
    """Distances of points from a plane as a sum of modes that are orthonormal in the mean over the points.

    The modes are quadratic and cubic in the image, and orthogonal to any tilt or shift of the plane. `amplitudes` (K,),
    their `covariance` (K, K) by scatter alone, and their derivatives by the points' distances, `influence` (K, N).
    """

    amplitudes: Floats
    covariance: Floats
    influence: Floats

    @property
    def deviation(self) -> float:
        """Root mean square of the smooth part of the distances."""
        return float(np.linalg.norm(self.amplitudes))


def plane_form(plane: FittedPlane, camera_px: Floats, cluster: Ints) -> PlaneForm:
    """The form of the points that a plane was fitted to, at pixels (N, 2); errors correlate in a `cluster` (N,)."""
    terms = monomials(camera_px)[:, _LINEAR:CUBIC]
    basis = orthonormal(np.concatenate([plane.jacobian.T, terms.T]).T)
    # Plane and form are fitted together: under the points' weights they are not quite orthogonal.
    modes = np.sqrt(len(camera_px)) * basis
    weighted = biweight(plane.residual)[:, None] * modes
    amplitudes = np.linalg.lstsq(weighted.T @ modes, weighted.T @ plane.residual, rcond=None)[0]
    residual = plane.residual - modes @ amplitudes
    form = slice(_LINEAR, None)
    covariance = robust_covariance(modes, residual, cluster)[form, form]
    return PlaneForm(amplitudes[form], covariance, influence_on(modes, residual)[form])
