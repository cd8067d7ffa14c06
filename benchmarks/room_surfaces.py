"""Distances of points from the true surfaces seen by the stations of a room."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from calib.numerics import Floats

_EVERY = 2  # sampling of the true points


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
