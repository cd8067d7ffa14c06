"""Errors of matches that vary so slowly over the image that no mean over them gets rid of them.

A decoder errs smoothly: fringes bent by a response, light that has bounced. Across the epipolar lines such errors show
in the rays' misses; along them, where they would pass for depth, they are taken to be of the same size.
"""

import numpy as np

from calib.numerics import Floats, Ints, biweight, biweight_slope
from calib.pointcloud import Sphere
from calib.refinement import CUBIC, monomials

# What a camera's pixel averages over, as a variance along rows and along columns: itself, and a blur of half a pixel.
_FOOTPRINT_PX2 = 1 / 12 + 1 / 4
# The share of what that does to a sphere that the decoder leaves, for it cannot be seen at the rim; measured.
_LEFT = 0.4
_RIM = 0.97  # of the radius squared, beyond which a footprint is as large as what it sees of the sphere
_ABSORBED = 3  # terms up to the linear ones: what a calibration makes of smooth errors, it makes of these first


def smooth_modes(pixel: Floats) -> Floats:
    """Polynomials up to the cubic over pixels (N, 2), orthonormal in the mean over them, lowest first: (N, ≤ 10)."""
    modes, _ = np.linalg.qr(monomials(pixel)[:, :CUBIC])
    scaled: Floats = np.sqrt(len(pixel)) * modes
    return scaled


def smooth_error_px(residual_px: Floats, modes: Floats, cluster: Ints) -> float:
    """Standard deviation of the amplitude of each mode (N, K) in the rays' misses (N,), in pixels.

    Measured on the quadratic and cubic modes and taken for all: the lower ones are where a calibration hides them. The
    few amplitudes make it as uncertain as Student's t, whose variance is larger by n / (n − 2). What errors that are
    alike within a `cluster` (N,) only would leave is taken off.
    """
    finite = np.where(np.isfinite(residual_px), residual_px, 0.0)
    from_median = finite - np.median(finite)
    weight, slope = biweight(from_median), biweight_slope(from_median)
    scores = (weight * finite)[:, None] * modes[:, _ABSORBED:] / max(slope.sum(), 1.0)
    totals = np.stack([np.bincount(cluster, column) for column in scores.T])
    count = len(totals)
    excess = np.sum(totals.sum(axis=1) ** 2) - np.sum(totals**2)
    return float(np.sqrt(max(excess, 0.0) / max(count - 2, 1)))


def footprint_offsets(sphere: Sphere, points: Floats, focal_px: float) -> Floats:
    """How far points (N, 3) of a sphere come out behind its surface, (N,), because a pixel averages over its footprint.

    Along the ray that would be ½ σ² ∇²z with z = −√(R² − r²), r the ray's distance from the centre.
    """
    distance = np.linalg.norm(points, axis=1)
    rays = points / distance[:, None]
    along = rays @ sphere.centre
    r2 = np.minimum(sphere.centre @ sphere.centre - along**2, _RIM * sphere.radius**2)
    left = sphere.radius**2 - r2
    behind = 0.5 * _LEFT * _FOOTPRINT_PX2 * (distance / focal_px) ** 2 * (sphere.radius**2 + left) / left**1.5
    outwards: Floats = behind * np.sqrt(left) / sphere.radius
    return outwards
