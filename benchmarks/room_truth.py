"""Distances in a room from the truth: of two balls by all stations' points on them, of points from true surfaces."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from calib.numerics import Floats
from calib.pointcloud import fit_sphere
from scanner.rooms import Station

_FEWEST = 50
_EVERY = 2  # sampling of the true points


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


def from_surfaces(points: Floats, seen: Sequence[Floats]) -> Floats:
    """Distances (N,) of points (N, 3) along the normal of the nearest point seen by a camera pixel.

    `seen`: for each station (H, W, 3) in the same frame, NaN where unknown.
    """
    surfaces, normals = [], []
    for world in seen:
        normal = np.cross(np.gradient(world, axis=1), np.gradient(world, axis=0)).reshape(-1, 3)
        flat = world.reshape(-1, 3)
        known = np.flatnonzero(np.isfinite(flat + normal).all(axis=1))[::_EVERY]
        surfaces.append(flat[known])
        normals.append(normal[known] / np.maximum(np.linalg.norm(normal[known], axis=1, keepdims=True), 1e-12))
    tree = cKDTree(np.concatenate(surfaces))
    _, nearest = tree.query(points)
    along: Floats = np.abs(np.sum((points - tree.data[nearest]) * np.concatenate(normals)[nearest], axis=1))
    return along
