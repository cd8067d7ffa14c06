"""Meshing of an organised cloud: triangles between neighbours in the image, cut at occlusion edges.

At an occlusion edge, the point of one pixel is far from the tangent plane at its neighbour's. On a smooth surface it is
near that plane, however oblique the view. At a crease its distance is less than that between both points, a few
footprints. A footprint is the step of one pixel at the point's depth, on a surface that faces the camera.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.numerics import Floats, Ints, compiled, in_slices, robust_sigma

# Largest distance from the tangent plane, in footprints per pixel of separation, and in sigmas of the usual distance.
_LARGEST_STEP, _LARGEST_STEP_SIGMAS = 6.0, 6.0
# Among scattered pixels, an edge longer than this multiple of the median spans a hole.
_LONGEST_EDGE = 3.0
_STRIP_ROWS, _STRIP_CELLS = 128, 1 << 20

Floats32 = NDArray[np.float32]


@dataclass(frozen=True)
class SeenPoints:
    """`points` (N, 3) in the camera's frame, unit `normals` (N, 3); the camera's `focal_px`.

    `pixel` (N, 2): where they are seen, no two in one pixel.
    """

    pixel: Floats
    points: Floats
    normals: Floats
    focal_px: float


def image_triangles(points: SeenPoints) -> Ints:
    """Triangles (T, 3) of point indices, counter-clockwise as seen by the camera.

    Where points are dense, each square of four pixels gives two triangles, or one if three of its pixels have points.
    Sparse points, as when the projector's pixels are larger than the camera's, are joined by a Delaunay triangulation
    of the image. Memory is that of the points, however large the image.
    """
    surface = _Surface(
        points.pixel.astype(np.float32, order="C"),
        points.points.astype(np.float32, order="C"),
        points.normals.astype(np.float32, order="C"),
        (points.points[:, 2] / points.focal_px).astype(np.float32),
    )
    triangles = _grid_triangles(surface, np.rint(points.pixel).astype(np.int64))
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


def _grid_triangles(surface: _Surface, pixel: Ints) -> Ints:
    if not len(pixel):
        return np.empty((0, 3), np.int32)
    (left, top), (right, bottom) = pixel.min(axis=0), pixel.max(axis=0)
    order = np.argsort(pixel[:, 1], kind="stable")
    column, row = (pixel[order] - (left, top)).T
    height, width = int(bottom - top + 1), int(right - left + 1)
    strip_rows = max(1, min(_STRIP_ROWS, _STRIP_CELLS // width))

    def strip_of(rows: slice) -> tuple[Ints, int]:
        """The point of each pixel of some rows, −1 for none, and the number of points."""
        own = slice(*np.searchsorted(row, (rows.start, rows.stop)))
        strip = np.full((min(rows.stop, height) - rows.start, width), -1)
        strip[row[own] - rows.start, column[own]] = order[own]
        return strip, own.stop - own.start

    def measure(rows: slice) -> Floats32:
        strip, _ = strip_of(rows)
        first, second = strip[:, :-1].ravel(), strip[:, 1:].ravel()
        both = (first >= 0) & (second >= 0)
        steps = np.empty(np.count_nonzero(both), np.float32)
        _steps(surface, first[both], second[both], steps)
        return steps

    def cut(rows: slice) -> Ints:
        strip, count = strip_of(slice(rows.start, rows.stop + 1))
        triangles = np.empty(
            (2 * count, 3), np.int32
        )  # a point is in four squares, a triangle takes two of these places
        return triangles[: _strip_triangles(surface, strip, limit, triangles)].copy()

    limit = _limit(np.concatenate(in_slices(height, strip_rows, measure)))
    return np.concatenate(in_slices(height - 1, strip_rows, cut))


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
        corners: Ints = scipy.spatial.Delaunay(surface.pixel.astype(np.float64)).simplices.astype(np.int64)
    except (scipy.spatial.QhullError, ValueError):  # fewer than three points, or all of them in a line
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
