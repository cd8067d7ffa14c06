"""How far apart two balls of a room are, by all stations' points on them."""

from collections.abc import Sequence

import numpy as np

from calib.numerics import Floats
from calib.pointcloud import fit_sphere

_FEWEST = 50


def centres_apart(balls: Sequence[Floats], rays: Sequence[Floats], radius_m: float) -> float:
    """Distance of the fitted centres of two balls, in metres, from the points (N, 3) of each, and unit vectors (N, 3)
    from the cameras to them; NaN where one was hardly seen.
    """
    centres = []
    for points, ray in zip(balls, rays, strict=True):
        if len(points) < _FEWEST:
            return float("nan")
        guess = points.mean(axis=0) + 0.5 * radius_m * ray.mean(axis=0)
        centres.append(fit_sphere(points, np.zeros(len(points), np.int64), guess, radius_m, rays=ray).centre)
    return float(np.linalg.norm(centres[1] - centres[0]))
