"""Smooth functions over an image: derivatives by pixels, and polynomials whose normal matrices are well conditioned."""

from collections.abc import Callable

import numpy as np
import scipy

from calib.numerics.arrays import Floats

DEGREE = 4
TERMS = (DEGREE + 1) * (DEGREE + 2) // 2
CONIC, CUBIC = 6, 10
# Smoothing and derivative filters that match each other (Farid and Simoncelli, IEEE TIP 13, 2004, table I): the slope
# is that of the smoothed image. Plain differences overestimate the motion of a sharp edge by 9 %, and of a wave of
# eight pixels by 10 %.
LEVEL, SLOPE = np.array(
    [[0.037659, 0.249153, 0.426375, 0.249153, 0.037659], [-0.109604, -0.276691, 0.0, 0.276691, 0.109604]]
)
_STEP_PX = 0.5
_SINGULAR = 1e-13  # relative eigenvalue of a normal matrix below which it is rounding error


def by_pixel(values: Callable[[Floats], Floats], pixels: Floats) -> Floats:
    """Derivatives (N, ..., 2) of smooth `values` (N, ...) of pixels (N, 2): central differences over one pixel."""
    steps = _STEP_PX * np.eye(2)
    return np.stack([(values(pixels + step) - values(pixels - step)) / (2 * _STEP_PX) for step in steps], axis=-1)


def normalisation(points: Floats) -> Floats:
    """Similarity (3, 3) that takes points (N, 2) to mean 0 and mean length √2 (Hartley 1997)."""
    centre = points.mean(axis=0)
    return scaling_about(centre, float(np.linalg.norm(points - centre, axis=1).mean()))


def scaling_about(centre: Floats, length: float) -> Floats:
    """Similarity (3, 3) that takes the centre (2,) to 0 and the length to √2; a length of 0 is kept."""
    scale = np.sqrt(2) / length if length > 0 else 1.0
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])


def monomials(pixels: Floats, scale: Floats | None = None) -> Floats:
    """Return all monomials of degree up to 4, lowest first: (N, 2) → (N, TERMS).

    `scale` (3, 3): normalisation of the pixels, by default their own.
    """
    scale = normalisation(pixels) if scale is None else scale
    x, y = scale[0, 0] * pixels.T + scale[:2, 2:]
    rows = np.empty((TERMS, len(pixels)))
    rows[0] = 1.0
    last, place = rows[:1], 1
    for degree in range(1, DEGREE + 1):
        here = rows[place : place + degree + 1]
        np.multiply(last, x, out=here[:-1])
        np.multiply(last[-1], y, out=here[-1])
        last, place = here, place + degree + 1
    return rows.T


def orthonormal_polynomials(pixels: Floats, root_weight: Floats | None = None) -> Floats:
    """Polynomials up to the cubic over pixels (N, 2), orthonormal over these, lowest first: (N, ≤ CUBIC).

    `root_weight` (N,): what they are multiplied by before, the square root of a weight.
    """
    terms = monomials(pixels)[:, :CUBIC]
    if root_weight is not None:
        terms = terms * root_weight[:, None]
    return orthonormal(terms)


def orthonormal(columns: Floats) -> Floats:
    """Orthonormal basis (N, ≤ M) of `columns` (N, M), each of those before it, by QR decomposition."""
    # NumPy's own copies row by row, which takes longer than the rest.
    return np.ascontiguousarray(scipy.linalg.qr(columns, mode="economic", check_finite=False)[0], np.float64)


def coefficients_of(terms: Floats, values: Floats, weight: Floats) -> Floats:
    """Solve weighted least squares by the normal equations, with minimum norm where these are singular.

    Terms (TERMS, N), values (N, 2), weights (N,) → coefficients (TERMS, 2).
    """
    weighted = terms * weight
    normal = weighted @ terms.T
    return np.linalg.pinv(normal, rcond=_SINGULAR, hermitian=True) @ (weighted @ values)
