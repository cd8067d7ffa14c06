"""Polynomials over the camera's image, in coordinates that keep their normal matrices well conditioned."""

import numpy as np

from calib.geometry import normalisation
from calib.numerics import Floats, compiled

DEGREE = 4
TERMS = (DEGREE + 1) * (DEGREE + 2) // 2
CONIC, CUBIC = 6, 10
_SINGULAR = 1e-13  # eigenvalues of a normal matrix, relative to its largest, that are rounding


def monomials(pixels: Floats, scale: Floats | None = None) -> Floats:
    """All monomials of degree up to 4, lowest first: (N, 2) → (N, TERMS).

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
    """Of the weighted least-squares fit: terms (TERMS, N), values (N, 2), weights (N,) → (TERMS, 2); the shortest."""
    normal, right = np.empty((len(terms), len(terms))), np.empty((len(terms), 2))
    _normal_equations(np.ascontiguousarray(terms), values, weight, normal, right)
    coefficients: Floats = np.linalg.pinv(normal, rcond=_SINGULAR, hermitian=True) @ right
    return coefficients


@compiled
def _normal_equations(terms: Floats, values: Floats, weight: Floats, normal: Floats, right: Floats) -> None:
    weighted = np.empty(len(weight))
    for a in range(len(terms)):
        u = v = 0.0
        for i in range(len(weight)):
            weighted[i] = weight[i] * terms[a, i]
            u += weighted[i] * values[i, 0]
            v += weighted[i] * values[i, 1]
        right[a, 0], right[a, 1] = u, v
        for b in range(a + 1):
            product = 0.0
            for i in range(len(weight)):
                product += weighted[i] * terms[b, i]
            normal[a, b] = normal[b, a] = product
