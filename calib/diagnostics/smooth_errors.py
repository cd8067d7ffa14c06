"""Smooth errors of matches, which averaging over a surface does not remove; and the smooth part of a face's distances
from a plane, its form.

Response curves and interreflection cause smooth errors. Across the epipolar lines they show in the rays' misses; along
them, where they change the depth, the same size is assumed.
"""

from dataclasses import dataclass

import numpy as np

from calib.numerics import (
    CUBIC,
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
