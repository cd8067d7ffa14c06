"""Projective data association: the pixel of another camera that a point falls on (Blais and Levine 1995).

Compiled steps that every loop over patches shares. A `lens` is (9,): both focal lengths, the principal point, and the
distortion as of `Intrinsics`.
"""

import numpy as np

from calib.numerics import Floats, compiled


@compiled
def rotated(r: Floats, vector: Floats) -> tuple[float, float, float]:
    """R (3, 3) times a vector (3,), without an array for the result."""
    a, b, c = vector[0], vector[1], vector[2]
    return (
        r[0, 0] * a + r[0, 1] * b + r[0, 2] * c,
        r[1, 0] * a + r[1, 1] * b + r[1, 2] * c,
        r[2, 0] * a + r[2, 1] * b + r[2, 2] * c,
    )


@compiled
def pixel_under(x: float, y: float, z: float, lens: Floats, height: int, width: int) -> tuple[int, int]:
    """Row and column that a point in the camera's frame falls on; (−1, −1) outside the picture or behind the camera."""
    if not z > 1e-9:
        return -1, -1
    u, v = x / z, y / z
    q = u * u + v * v
    radial = 1 + q * (lens[4] + q * (lens[5] + q * lens[8]))
    across = u * radial + 2 * lens[6] * u * v + lens[7] * (q + 2 * u * u)
    down = v * radial + lens[6] * (q + 2 * v * v) + 2 * lens[7] * u * v
    column, row = np.floor(lens[0] * across + lens[2] + 0.5), np.floor(lens[1] * down + lens[3] + 0.5)
    if not (0 <= column < width and 0 <= row < height):
        return -1, -1
    return int(row), int(column)
