"""Polynomials over the camera's image, in coordinates that keep their normal matrices well conditioned."""

import numpy as np

from calib.geometry import normalisation
from calib.numerics import Floats

DEGREE = 4
TERMS = (DEGREE + 1) * (DEGREE + 2) // 2
CONIC, CUBIC = 6, 10
_SINGULAR = 1e-13  # relative eigenvalue of a normal matrix below which it is rounding error


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


def coefficients_of(terms: Floats, values: Floats, weight: Floats) -> Floats:
    """Solve weighted least squares by the normal equations, with minimum norm where these are singular.

    Terms (TERMS, N), values (N, 2), weights (N,) → coefficients (TERMS, 2).
    """
    weighted = terms * weight
    normal = weighted @ terms.T
    return np.linalg.pinv(normal, rcond=_SINGULAR, hermitian=True) @ (weighted @ values)
