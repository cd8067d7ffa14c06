"""Region growing: extend the plane through the patch around each surfel to all its inliers.

A surfel is a column of `Evidence.rows` (surfels.py). A symmetric matrix (3, 3) is stored as its six entries
00, 01, 02, 11, 12, 22.
"""

import numpy as np

from calib.numerics import Bools, Floats, Ints, compiled, in_pieces
from calib.plane_segmentation.surfels import Surfels

_GROWTH_STEPS = 6
_PATCHES = np.array([3, 5])  # side of a seed's patch in cells; the larger one if it is planar
_FEWEST_IN_PATCH = 6
# By how much a plane's own uncertainty widens the gate for its offset while it grows, in variances of the surfel.
_REACH = 25.0
_RIDGE = 1e-12


def local_planes(surfels: Surfels, rows: Floats, gate: float) -> tuple[Floats, Floats, Bools]:
    """Fit a plane to the patch around each surfel: planes (M, 3), covariances (M, 6), and a mask of planar patches."""
    grid, count = surfels.grid, len(surfels)
    at = np.full(grid.rows * grid.columns, -1, np.int32)
    at[surfels.cell] = np.arange(count)
    planes, covariance, usable = np.zeros((count, 3)), np.zeros((count, 6)), np.zeros(count, np.bool_)
    _fit_patches(rows, at.reshape(grid.rows, grid.columns), surfels.cell, gate, planes, covariance, usable)
    return planes, covariance, usable


def grow(rows: Floats, seeds: Floats, covariance: Floats, gate: float) -> tuple[Floats, Bools]:
    """Grow each seed plane (S, 3), with covariance (S, 6), by refitting it to the inliers within its uncertainty.

    Return the plane (3,) with the most inliers, and the mask of these (M,).
    """
    planes, covariance, explained = seeds.copy(), covariance.copy(), np.empty(len(seeds))
    in_pieces(
        len(seeds),
        lambda at: _grow(rows, planes[at], covariance[at], gate**2, explained[at]),
        width=rows.shape[1],
    )
    best = int(np.argmax(explained))
    weight = np.empty(rows.shape[1])
    _weigh(rows, planes[best], covariance[best], gate**2, 0.0, weight)
    return planes[best], weight > 0


@compiled
def _fit_patches(
    rows: Floats, at: Ints, cell: Ints, gate: float, planes: Floats, covariance: Floats, usable: Bools
) -> None:
    """`at` (rows, columns): the surfel in each cell of the grid, −1 for none; `cell` (M,): where each surfel is."""
    height, width = at.shape
    moments, inverse, plane = np.empty(9), np.empty(6), np.empty(3)
    for m in range(len(cell)):
        row, column = cell[m] // width, cell[m] % width
        for side in _PATCHES:
            half, count, square = side // 2, 0, 0.0
            for k in range(9):
                moments[k] = 0.0
            for j in range(max(0, row - half), min(height, row + half + 1)):
                for i in range(max(0, column - half), min(width, column + half + 1)):
                    n = at[j, i]
                    if n >= 0:
                        value, x, y, z = rows[0, n], rows[1, n], rows[2, n], rows[3, n]
                        moments[0] += x * x
                        moments[1] += x * y
                        moments[2] += x * z
                        moments[3] += y * y
                        moments[4] += y * z
                        moments[5] += z * z
                        moments[6] += x * value
                        moments[7] += y * value
                        moments[8] += z * value
                        square += value * value
                        count += 1
            if count >= _FEWEST_IN_PATCH:
                _solve(moments, inverse, plane)
                chi2 = square - plane[0] * moments[6] - plane[1] * moments[7] - plane[2] * moments[8]
                if chi2 < gate * (count - 3):
                    usable[m] = True
                    for k in range(3):
                        planes[m, k] = plane[k]
                    for k in range(6):
                        covariance[m, k] = inverse[k]


@compiled
def _grow(rows: Floats, planes: Floats, covariance: Floats, gate2: float, explained: Floats) -> None:
    """Grow every seed's plane and covariance in place, and fill in its final number of inliers."""
    weight, moments = np.empty(rows.shape[1]), np.empty(9)
    for s in range(len(planes)):
        before = np.nan
        for _ in range(_GROWTH_STEPS):
            _weigh(rows, planes[s], covariance[s], gate2, _REACH, weight)
            if _add_up(rows, weight, moments) < _FEWEST_IN_PATCH:
                planes[s, 0] = np.nan  # no inliers
                break
            if moments[6] == before:  # the same surfels again
                break
            before = moments[6]
            _solve(moments, covariance[s], planes[s])
        _weigh(rows, planes[s], covariance[s], gate2, 0.0, weight)
        explained[s] = _add_up(rows, weight, moments)


@compiled
def _weigh(rows: Floats, plane: Floats, covariance: Floats, gate2: float, reach: float, weight: Floats) -> None:
    """1 for a surfel that lies on a plane and slopes like it, within its own errors and the plane's, 0 for others (M,).

    The plane's own variance counts up to `reach` for the offset.
    """
    for m in range(len(weight)):
        weight[m] = (
            _within(rows[0, m], rows[1, m], rows[2, m], rows[3, m], plane, covariance, gate2, reach)
            * _within(rows[4, m], rows[5, m], rows[6, m], rows[7, m], plane, covariance, gate2, np.inf)
            * _within(rows[8, m], rows[9, m], rows[10, m], rows[11, m], plane, covariance, gate2, np.inf)
        )


@compiled
def _within(value: float, x: float, y: float, z: float, plane: Floats, c: Floats, gate2: float, reach: float) -> float:
    """Return 1 if a number of unit variance agrees with the plane with covariance c, else 0: a factor, not a branch."""
    off = value - plane[0] * x - plane[1] * y - plane[2] * z
    own = x * (c[0] * x + 2.0 * (c[1] * y + c[2] * z)) + y * (c[3] * y + 2.0 * c[4] * z) + z * c[5] * z
    return 1.0 if off * off < gate2 * (1.0 + (own if own < reach else reach)) else 0.0


@compiled
def _add_up(rows: Floats, weight: Floats, moments: Floats) -> float:
    """Sum x xᵀ and x value, nine numbers, over the surfels of weight 1, and count these."""
    count = xx = xy = xz = yy = yz = zz = xv = yv = zv = 0.0
    for m in range(len(weight)):
        value, x, y, z = rows[0, m], weight[m] * rows[1, m], weight[m] * rows[2, m], weight[m] * rows[3, m]
        count += weight[m]
        xx += x * x
        xy += x * y
        xz += x * z
        yy += y * y
        yz += y * z
        zz += z * z
        xv += x * value
        yv += y * value
        zv += z * value
    moments[0], moments[1], moments[2], moments[3], moments[4], moments[5] = xx, xy, xz, yy, yz, zz
    moments[6], moments[7], moments[8] = xv, yv, zv
    return count


@compiled
def _solve(moments: Floats, inverse: Floats, plane: Floats) -> None:
    """Invert a normal matrix (6,) by L D Lᵀ and solve for the plane (3,).

    The variance is large instead of infinite in directions that collinear surfels do not determine.
    """
    a, b, c, d, e, f = moments[0], moments[1], moments[2], moments[3], moments[4], moments[5]
    xv, yv, zv = moments[6], moments[7], moments[8]
    ridge = _RIDGE * (a + d + f)
    d0 = a + ridge
    l10, l20 = b / d0, c / d0
    d1 = d + ridge - l10 * b
    l21 = (e - l10 * c) / d1
    d2 = f + ridge - l20 * c - l21 * (e - l10 * c)
    k20 = l10 * l21 - l20
    inverse[0] = 1.0 / d0 + l10 * l10 / d1 + k20 * k20 / d2
    inverse[1] = -l10 / d1 - k20 * l21 / d2
    inverse[2] = k20 / d2
    inverse[3] = 1.0 / d1 + l21 * l21 / d2
    inverse[4] = -l21 / d2
    inverse[5] = 1.0 / d2
    plane[0] = inverse[0] * xv + inverse[1] * yv + inverse[2] * zv
    plane[1] = inverse[1] * xv + inverse[3] * yv + inverse[4] * zv
    plane[2] = inverse[2] * xv + inverse[4] * yv + inverse[5] * zv
