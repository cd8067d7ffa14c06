"""Points seen by a camera → triangles between neighbours in its image, cut where one surface hides another.

Neighbouring pixels see neighbouring points of one surface unless an occlusion edge runs between them. There, the point
of the one pixel lies far off the tangent plane at the other's; on a smooth surface it lies in it, however obliquely the
surface is seen. At a crease it lies off by less than the distance of the two, which is a few footprints: the footprint
is the step of one pixel at the point's depth on a surface that faces the camera.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from calib.arrays import Bools, Floats, Ints
from calib.fit_statistics import SIGMA_PER_MEDIAN
from calib.pixel_index import NONE

# Off the tangent plane by more than this many footprints per pixel between the two, or so many sigmas of the usual.
_LARGEST_STEP, _LARGEST_STEP_SIGMAS = 6.0, 6.0
# Among scattered pixels, an edge longer than this many times the median edge spans a place without points.
_LONGEST_EDGE = 3.0
_STRIP_ROWS = 128

Floats32 = NDArray[np.float32]


@dataclass(frozen=True)
class SeenPoints:
    """`pixel` (N, 2): where the camera sees the points. `points` (N, 3) in its frame, `normals` (N, 3) of unit length.

    `focal_px` is the camera's.
    """

    pixel: Floats
    points: Floats
    normals: Floats
    focal_px: float


def image_triangles(seen: SeenPoints, index: Ints) -> Ints:
    """Triangles (T, 3) of indices of points, their corners counter-clockwise as seen by the camera.

    `index` (H, W): which point each pixel has, `NONE` for none. Where nearly every pixel has one, each square of four
    neighbours gives two triangles, or one if three of its pixels have points. Where there is one point for several
    pixels, as when the projector's pixels are larger than the camera's, they are Delaunay's triangles in the image.
    """
    surface = _Surface(seen)
    triangles = _grid_triangles(surface, index)
    return triangles if len(triangles) >= len(seen.pixel) else _scattered_triangles(surface)


class _Surface:
    """Points whose steps from each to each can be judged; in single precision, for there may be many."""

    def __init__(self, seen: SeenPoints) -> None:
        self.pixel = seen.pixel.astype(np.float32)
        self.points = seen.points.astype(np.float32)
        self.normals = seen.normals.astype(np.float32)
        self.footprint = (seen.points[:, 2] / seen.focal_px).astype(np.float32)

    def steps(self, p: Ints, q: Ints) -> Floats32:
        """How far each of two points lies off the other's tangent plane: the larger, in footprints per pixel.

        `p` and `q` are indices of one shape; infinite where one of them is `NONE`.
        """
        there = (p != NONE) & (q != NONE)
        a, b = p[there], q[there]
        apart = self.points[b] - self.points[a]
        off = np.maximum(
            np.abs(np.einsum("ni,ni->n", self.normals[a], apart)), np.abs(np.einsum("ni,ni->n", self.normals[b], apart))
        )
        steps = np.full(p.shape, np.inf, np.float32)
        steps[there] = off / np.minimum(self.footprint[a], self.footprint[b]) / self.lengths_px(a, b)
        return steps

    def lengths_px(self, p: Ints, q: Ints) -> Floats32:
        """Distances in the image, of pixels at least."""
        lengths: Floats32 = np.maximum(np.linalg.norm(self.pixel[p] - self.pixel[q], axis=1), np.float32(1))
        return lengths


def _limit(steps: Floats32) -> float:
    """How large a step may be, given many, of which few are across occlusion edges."""
    there = steps[np.isfinite(steps)]
    usual = SIGMA_PER_MEDIAN * float(np.median(there)) if len(there) else 0.0
    return max(_LARGEST_STEP, _LARGEST_STEP_SIGMAS * usual)


def _grid_triangles(surface: _Surface, index: Ints) -> Ints:
    limit = _limit(surface.steps(index[:, :-1], index[:, 1:]))
    strips = [
        _strip_triangles(surface, index[top : top + _STRIP_ROWS + 1], limit)
        for top in range(0, max(1, len(index) - 1), _STRIP_ROWS)
    ]
    return np.concatenate(strips)


def _strip_triangles(surface: _Surface, index: Ints, limit: float) -> Ints:
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    ab, cd, ac, bd, ad, bc = (surface.steps(p, q) for p, q in ((a, b), (c, d), (a, c), (b, d), (a, d), (b, c)))
    falling = ad < bc  # the diagonal from the top left to the bottom right is the smoother one
    uncut: tuple[tuple[tuple[Ints, Ints, Ints], Bools], ...] = (
        ((a, c, d), falling & (np.maximum(np.maximum(ac, cd), ad) <= limit)),
        ((a, d, b), falling & (np.maximum(np.maximum(ad, bd), ab) <= limit)),
        ((a, c, b), ~falling & (np.maximum(np.maximum(ac, bc), ab) <= limit)),
        ((b, c, d), ~falling & (np.maximum(np.maximum(bc, cd), bd) <= limit)),
    )
    return np.concatenate([np.stack([corner[kept] for corner in corners], axis=1) for corners, kept in uncut])


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
    steps = np.stack([surface.steps(p, q) for p, q in edges])
    lengths = np.stack([surface.lengths_px(p, q) for p, q in edges])
    kept = (steps.max(axis=0) <= _limit(steps.ravel())) & (lengths.max(axis=0) <= _LONGEST_EDGE * np.median(lengths))
    triangles: Ints = corners[kept]
    return triangles
