"""How far apart two balls of a room are, by all stations' points on them."""

from collections.abc import Sequence

import numpy as np

from calib.numerics import Floats
from calib.pointcloud import fit_sphere

_FEWEST = 50


def centres_apart(balls: Sequence[Floats], radius_m: float, seen_from: Floats) -> float:
    """Distance of the fitted centres of two balls, in metres, from the points (N, 3) of each; NaN where one was hardly
    seen. `seen_from` (3,): about where from, which tells on which side of its points a centre is.
    """
    centres = []
    for points in balls:
        if len(points) < _FEWEST:
            return float("nan")
        away = points.mean(axis=0) - seen_from
        guess = points.mean(axis=0) + 0.5 * radius_m * away / np.linalg.norm(away)
        centres.append(fit_sphere(points, np.zeros(len(points), np.int64), guess, radius_m).centre)
    return float(np.linalg.norm(centres[1] - centres[0]))
