"""Smoothing by what is known of the noise: points move along their normals to a quadratic surface among neighbours.

Neighbours weigh by their variances, and less the less they fit to it (Tukey's biweight), so that those beyond
an edge do not count. As much of a move is made as the scatter of the neighbours is noise (Lee, "Digital image
enhancement and noise filtering by use of local statistics", 1980): none where they are apart by form.
"""

from collections.abc import Callable

import numpy as np
import scipy

from calib.numerics import Floats, Ints

_NEIGHBOURS = 48
_AT_ONCE = 20_000
_ITERATIONS = 4
_CUT = 4.0  # standard deviations beyond which a neighbour does not count
_FARTHEST = 5.0  # standard deviations that one neighbour counts for in the scatter
_MOST = 3.0  # standard deviations that a point moves at most
_TERMS = 6  # of a quadratic surface
_RIDGE = 1e-9
_LEAST_ALIKE = 0.9  # cosine of the angle between normals of one surface
_LEAST_SHARE = 0.5  # of the neighbours that have to be of the surface, for a point to move


def smoothed(points: Floats, normals: Floats, sigma_along: Callable[[slice, Floats], Floats]) -> Floats:
    """Points (N, 3) moved along their `normals` (N, 3), whose standard deviation along them `sigma_along` says of
    each part of the points and its normals.
    """
    count = min(_NEIGHBOURS, len(points))
    if count <= _TERMS:
        return points
    parts = [slice(start, min(start + _AT_ONCE, len(points))) for start in range(0, len(points), _AT_ONCE)]
    sigma = np.concatenate([sigma_along(part, normals[part]) for part in parts])
    tree = scipy.spatial.cKDTree(points)
    moved = points.copy()
    for part in parts:
        _, near = tree.query(points[part], count)
        moved[part] += _steps(points, normals, sigma, part, np.asarray(near, np.int64))[:, None] * normals[part]
    return moved


def _steps(points: Floats, normals: Floats, sigma: Floats, part: slice, near: Ints) -> Floats:
    """How far the points of a part (n) move along their normals, from their neighbours `near` (n, k)."""
    normal, own = normals[part], sigma[part]
    apart = points[near] - points[part][:, None]
    height = np.einsum("nki,ni->nk", apart, normal)
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    u, v = (np.einsum("nki,ni->nk", apart, axis) for axis in (across, np.cross(normal, across)))
    reach = np.maximum(np.max(np.hypot(u, v), axis=1, keepdims=True), 1e-30)
    u, v = u / reach, v / reach
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    variance = sigma[near] ** 2
    alike = np.einsum("nki,ni->nk", normals[near], normal) > _LEAST_ALIKE
    prior = np.where(alike, 1 / variance, 0.0)
    weight, residual, step = prior, height, np.zeros(len(normal))
    for _ in range(_ITERATIONS):
        weighted = weight[..., None] * design
        matrix = np.einsum("nki,nkj->nij", weighted, design)
        ridge = _RIDGE * np.trace(matrix, axis1=1, axis2=2)[:, None, None] * np.eye(_TERMS)
        fit = np.linalg.solve(
            matrix + ridge + 1e-300 * np.eye(_TERMS), np.einsum("nki,nk->ni", weighted, height)[..., None]
        )
        residual, step = height - (design @ fit)[..., 0], fit[:, 0, 0]
        weight = np.clip(1 - residual**2 / (_CUT**2 * variance), 0.0, None) ** 2 * prior
    scatter = np.mean(np.minimum(residual**2 / variance, _FARTHEST**2), axis=1)  # over noise; 1 on a surface
    enough = np.count_nonzero(weight > 0, axis=1) >= _LEAST_SHARE * near.shape[1]
    step = np.where(enough, step / np.maximum(scatter, 1.0), 0.0)
    steps: Floats = np.clip(step, -_MOST * own, _MOST * own)
    return steps
