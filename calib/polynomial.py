"""Polynomials over the camera's image, in coordinates that keep their normal matrices well conditioned."""

import numpy as np

from calib.arrays import Floats
from calib.homography import normalisation

DEGREE = 4
TERMS = (DEGREE + 1) * (DEGREE + 2) // 2
CONIC, CUBIC = 6, 10


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
