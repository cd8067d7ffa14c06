"""Which triangle each pixel of a device meets first, exactly, through its lens.

Homogeneous edge functions (Olano and Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997): the ray
r = (x, y, 1) of a pixel meets the triangle of v₀, v₁, v₂ where r · (v₁ × v₂), r · (v₂ × v₀) and r · (v₀ × v₁) have the
sign of v₀ · (v₁ × v₂). Their shares of their sum are the barycentric coordinates. The depth is the quotient of that
product and the sum. Nothing is clipped, and as each pixel has a ray of its own, the lens need not be straight.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints, compiled

_TILE_PX = 16  # columns of a row that are tested at once
_NOTHING = -1


@dataclass(frozen=True, eq=False)
class TriangleHits:
    """What the rays of some rows of pixels meet: the number of the nearest triangle, -1 if none, and the `depth` there
    along the device's axis, infinite if nothing; both (n, W).
    """

    triangle: NDArray[np.int32]
    depth: NDArray[np.float32]


class TriangleRaster:
    """Triangles (T, 3) of points (N, 3) in the frame of the device that sees them."""

    def __init__(self, points: Floats, triangles: Ints) -> None:
        self.points, self._corners = np.ascontiguousarray(points), np.sort(triangles, axis=1)
        self._bounds = np.empty((len(triangles), 4), np.float32)
        _bound(self.points, self._corners, self._bounds)

    def hits(self, rays: Floats) -> TriangleHits:
        """Of rays (n, W, 2): where those of the pixels of neighbouring rows meet z = 1; NaN where there is no ray."""
        height, width = rays.shape[:2]
        triangle, depth = np.full((height, width), _NOTHING, np.int32), np.full((height, width), np.inf, np.float32)
        bounds = np.empty((2, 2, height, -(-width // _TILE_PX)))
        _bound_tiles(rays, bounds)
        (left, right), (top, bottom) = bounds
        # Wherever a lens may put its columns: no tile before `first` reaches as far, none behind `last` begins so soon.
        first = np.maximum.accumulate(right.max(axis=0))
        last = np.ascontiguousarray(np.minimum.accumulate(left.min(axis=0)[::-1])[::-1])
        rows = np.stack([top.min(axis=1), bottom.max(axis=1)])
        _cast(rays, top, bottom, first, last, rows, self.points, self._corners, self._bounds, triangle, depth)
        return TriangleHits(triangle, depth)


@compiled
def _bound_tiles(rays: Floats, bounds: Floats) -> None:
    """Of x and y of the rays (n, W, 2) in each tile of a row, the smallest and the largest, (2, 2, n, tiles); of rays
    that are NaN, an empty range.
    """
    for axis in range(2):
        for row in range(rays.shape[0]):
            for tile in range(bounds.shape[3]):
                smallest, largest = np.inf, -np.inf
                for column in range(tile * _TILE_PX, min((tile + 1) * _TILE_PX, rays.shape[1])):
                    value = rays[row, column, axis]
                    smallest = value if value < smallest else smallest
                    largest = value if value > largest else largest
                bounds[axis, 0, row, tile], bounds[axis, 1, row, tile] = smallest, largest


@compiled
def _bound(points: Floats, triangles: Ints, bounds: NDArray[np.float32]) -> None:
    """The smallest and the largest x / z, then y / z, of the part of each triangle that is in front of the device.

    An edge that passes z = 0 goes there to infinity, in the direction in which it passes.
    """
    for i in range(len(triangles)):
        bounds[i, 0] = bounds[i, 2] = np.inf
        bounds[i, 1] = bounds[i, 3] = -np.inf
        for side in range(3):
            a, b = triangles[i, side], triangles[i, (side + 1) % 3]
            z, z_next = points[a, 2], points[b, 2]
            for axis in range(2):
                smallest, largest = np.inf, -np.inf
                if z > 0.0:
                    smallest = largest = points[a, axis] / z
                if (z > 0.0) != (z_next > 0.0):
                    at = points[a, axis] * z_next - points[b, axis] * z
                    at = at if z_next > z else -at
                    smallest = -np.inf if at <= 0.0 else smallest
                    largest = np.inf if at >= 0.0 else largest
                # A few units in the last place wider, as its numbers are rounded.
                bounds[i, 2 * axis] = min(bounds[i, 2 * axis], smallest - 1e-6 * abs(smallest))
                bounds[i, 2 * axis + 1] = max(bounds[i, 2 * axis + 1], largest + 1e-6 * abs(largest))


@compiled
def _cast(
    rays: Floats,
    low: Floats,
    high: Floats,
    first: Floats,
    last: Floats,
    rows: Floats,
    points: Floats,
    corners: Ints,
    bounds: NDArray[np.float32],
    triangle: NDArray[np.int32],
    depth: NDArray[np.float32],
) -> None:
    """Keep the nearest triangle of each pixel of rows (n, W), by its ray (n, W, 2).

    `low`, `high` (n, tiles): the range of y of the pixels of a tile. `first`, `last` (tiles,): as far as x reaches
    up to a tile, and from where on behind it. `rows` (2, n): the range of y of each row.
    """
    height, width = depth.shape
    lowest, highest = rows[0].min(), rows[1].max()
    leftmost, rightmost = last[0], first[-1]
    for i in range(len(corners)):
        left, right, top, bottom = bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3]
        if not ((bottom >= lowest) & (top <= highest) & (right >= leftmost) & (left <= rightmost)):
            continue
        begin, end = np.searchsorted(first, left), np.searchsorted(last, right, side="right")
        if begin >= end:
            continue
        # The three edge functions a x + b y + c, from the corner with the lower number: both triangles of an edge round
        # it alike, so that no ray passes between them.
        p, q, r = points[corners[i, 0]], points[corners[i, 1]], points[corners[i, 2]]
        a0, b0, c0 = q[1] * r[2] - q[2] * r[1], q[2] * r[0] - q[0] * r[2], q[0] * r[1] - q[1] * r[0]
        a1, b1, c1 = p[1] * r[2] - p[2] * r[1], p[2] * r[0] - p[0] * r[2], p[0] * r[1] - p[1] * r[0]
        a2, b2, c2 = p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]
        product = p[0] * a0 + p[1] * b0 + p[2] * c0
        sign = 1.0 if product > 0.0 else -1.0
        product *= sign
        for row in range(height):
            if not ((rows[1, row] >= top) & (rows[0, row] <= bottom)):
                continue
            for tile in range(begin, end):
                if not ((high[row, tile] >= top) & (low[row, tile] <= bottom)):
                    continue
                for column in range(tile * _TILE_PX, min((tile + 1) * _TILE_PX, width)):
                    u, v = rays[row, column, 0], rays[row, column, 1]
                    e0, e1, e2 = a0 * u + b0 * v + c0, a1 * u + b1 * v + c1, a2 * u + b2 * v + c2
                    if (sign * e0 >= 0.0) & (sign * e1 <= 0.0) & (sign * e2 >= 0.0):
                        total = sign * (e0 - e1 + e2)
                        if product < total * depth[row, column]:
                            depth[row, column] = product / total
                            triangle[row, column] = i
