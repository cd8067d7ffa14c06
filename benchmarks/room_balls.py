"""Distance of two balls in a room, by all stations' points on them."""

from collections.abc import Sequence

import numpy as np

from calib.numerics import Floats
from calib.pointcloud import fit_sphere
from scanner.rooms import Station

_FEWEST = 50


def centres_apart(stations: Sequence[Station], balls: Sequence[Sequence[Floats]], radius_m: float) -> float:
    """Distance of the fitted centres of two balls, in metres; NaN if one has too few points.

    `stations`: for each ball, the points (N, 3) of each station on it; NaN without any.
    """
    centres = []
    for ball in balls:
        known = [points[np.isfinite(points[:, 2])].astype(np.float64) for points in ball]
        points = np.concatenate([station.to_room(own) for station, own in zip(stations, known, strict=True)])
        if len(points) < _FEWEST:
            return float("nan")
        eyes = [np.broadcast_to(each.place.translation, own.shape) for each, own in zip(stations, known, strict=True)]
        rays = points - np.concatenate(eyes)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        guess = points.mean(axis=0) + 0.5 * radius_m * rays.mean(axis=0)
        centres.append(fit_sphere(points, np.zeros(len(points), np.int64), guess, radius_m, rays=rays).centre)
    return float(np.linalg.norm(centres[1] - centres[0]))
