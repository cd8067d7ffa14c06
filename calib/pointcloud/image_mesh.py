"""Meshing of an organised cloud: triangles between neighbours in the image, cut at occlusion edges.

At an occlusion edge, the point of one pixel is far from the tangent plane at its neighbour's. On a smooth surface it is
near that plane, however oblique the view. At a crease its distance is less than that between both points, a few
footprints. A footprint is the step of one pixel at the point's depth, on a surface that faces the camera.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from calib.numerics import Floats, Ints, compiled, in_slices, robust_sigma

# Largest distance from the tangent plane, in footprints per pixel of separation, and in sigmas of the usual distance.
_LARGEST_STEP, _LARGEST_STEP_SIGMAS = 6.0, 6.0
# Among scattered pixels, an edge longer than this multiple of the median spans a hole.
_LONGEST_EDGE = 3.0
_STRIP_ROWS = 128

Floats32 = NDArray[np.float32]


@dataclass(frozen=True)
class SeenPoints:
    """`points` (N, 3) in the camera's frame, their `pixel` (N, 2) and unit `normals` (N, 3); camera's `focal_px`."""

    pixel: Floats
    points: Floats
    normals: Floats
    focal_px: float


def image_triangles(points: SeenPoints, index: Ints) -> Ints:
    """Triangles (T, 3) of point indices, counter-clockwise as seen by the camera.

    `index` (H, W): the point of each pixel, as in `pixel_grid`. In a dense grid, each square of four neighbours gives
    two triangles, or one if three of its pixels have points. Sparse points, as when the projector's pixels are larger
    than the camera's, are joined by a Delaunay triangulation of the image.
    """
    surface = _Surface(
        points.pixel.astype(np.float32, order="C"),
        points.points.astype(np.float32, order="C"),
        points.normals.astype(np.float32, order="C"),
        (points.points[:, 2] / points.focal_px).astype(np.float32),
    )
    triangles = _grid_triangles(surface, index)
    return triangles if len(triangles) >= len(points.pixel) else _scattered_triangles(surface)


class _Surface(NamedTuple):
    """As `SeenPoints`, with each point's footprint (N,), in single precision to save memory."""

    pixel: Floats32
    points: Floats32
    normals: Floats32
    footprint: Floats32


def _limit(steps: Floats32) -> float:
    """The largest step on a surface, from many steps of which few cross occlusion edges."""
    return max(_LARGEST_STEP, _LARGEST_STEP_SIGMAS * robust_sigma(steps[np.isfinite(steps)].astype(np.float64)))


def _grid_triangles(surface: _Surface, index: Ints) -> Ints:
    along_rows = np.empty((len(index), max(0, index.shape[1] - 1)), np.float32)

    def measure(rows: slice) -> None:
        strip = np.ascontiguousarray(index[rows], np.int64)
        _steps(surface, strip[:, :-1].ravel(), strip[:, 1:].ravel(), along_rows[rows].reshape(-1))

    def cut(rows: slice) -> Ints:
        strip = np.ascontiguousarray(index[rows.start : rows.stop + 1], np.int64)
        triangles = np.empty((2 * strip.size, 3), np.int32)
        return triangles[: _strip_triangles(surface, strip, limit, triangles)].copy()

    in_slices(len(index), _STRIP_ROWS, measure)
    limit = _limit(along_rows)
    return np.concatenate(in_slices(len(index) - 1, _STRIP_ROWS, cut))


@compiled
def _step(surface: _Surface, a: int, b: int) -> np.float32:
    """The larger distance of two points from each other's tangent plane, in footprints per pixel.

    Infinite if an index is negative, for a missing point.
    """
    if a < 0 or b < 0:
        return np.float32(np.inf)
    apart_x = surface.points[b, 0] - surface.points[a, 0]
    apart_y = surface.points[b, 1] - surface.points[a, 1]
    apart_z = surface.points[b, 2] - surface.points[a, 2]
    n, m = surface.normals[a], surface.normals[b]
    off = max(
        abs(n[0] * apart_x + n[1] * apart_y + n[2] * apart_z), abs(m[0] * apart_x + m[1] * apart_y + m[2] * apart_z)
    )
    across, down = surface.pixel[a, 0] - surface.pixel[b, 0], surface.pixel[a, 1] - surface.pixel[b, 1]
    length_px = np.sqrt(max(across * across + down * down, np.float32(1)))
    step: np.float32 = off / (min(surface.footprint[a], surface.footprint[b]) * length_px)
    return step


@compiled
def _steps(surface: _Surface, p: Ints, q: Ints, steps: Floats32) -> None:
    """Fill in the steps (N,) from points of one index to those of another."""
    for i in range(len(steps)):
        steps[i] = _step(surface, p[i], q[i])


@compiled
def _strip_triangles(surface: _Surface, index: Ints, limit: float, triangles: Ints) -> int:
    """Write the triangles of a strip's squares (a, b over c, d) without steps beyond the limit; returns their count."""
    count = 0
    for row in range(len(index) - 1):
        for column in range(index.shape[1] - 1):
            a, b, c, d = index[row, column], index[row, column + 1], index[row + 1, column], index[row + 1, column + 1]
            falling, rising = _step(surface, a, d), _step(surface, b, c)
            # The smoother diagonal, and on either side of it the corner that is left.
            if falling < rising:
                diagonal, first, second, lower, upper = falling, a, d, c, b
            else:
                diagonal, first, second, lower, upper = rising, c, b, d, a
            if diagonal <= limit:
                if max(_step(surface, first, lower), _step(surface, lower, second)) <= limit:
                    triangles[count, 0], triangles[count, 1], triangles[count, 2] = first, lower, second
                    count += 1
                if max(_step(surface, second, upper), _step(surface, upper, first)) <= limit:
                    triangles[count, 0], triangles[count, 1], triangles[count, 2] = first, second, upper
                    count += 1
    return count


def _scattered_triangles(surface: _Surface) -> Ints:
    try:
        corners: Ints = Delaunay(surface.pixel.astype(np.float64)).simplices.astype(np.int64)
    except (QhullError, ValueError):  # fewer than three points, or all of them in a line
        return np.empty((0, 3), np.int64)
    first, second, third = surface.pixel[corners].transpose(1, 0, 2)
    (ax, ay), (bx, by) = (second - first).T, (third - first).T
    clockwise = ax * by - ay * bx > 0  # as seen, since y runs down
    corners[clockwise] = corners[clockwise][:, ::-1]
    edges = [(corners[:, i], corners[:, (i + 1) % 3]) for i in range(3)]
    steps = np.empty((3, len(corners)), np.float32)
    for number, (p, q) in enumerate(edges):
        _steps(surface, p.copy(), q.copy(), steps[number])
    lengths = np.stack([np.linalg.norm(surface.pixel[p] - surface.pixel[q], axis=1) for p, q in edges])
    kept = (steps.max(axis=0) <= _limit(steps.ravel())) & (lengths.max(axis=0) <= _LONGEST_EDGE * np.median(lengths))
    triangles: Ints = corners[kept]
    return triangles
