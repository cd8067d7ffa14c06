"""Points on the camera's pixel grid → triangles, cut where one surface hides another.

Neighbouring pixels see neighbouring points of one surface unless an occlusion edge runs between them. There, the point
of the one pixel lies far off the tangent plane at the other's; on a smooth surface it lies in it, however obliquely the
surface is seen. At a crease it lies off by less than the distance of the two, which is a few footprints: the footprint
is the step of one pixel at the point's depth on a surface that faces the camera.
"""

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Bools, Floats, Ints
from calib.fit_statistics import SIGMA_PER_MEDIAN

NONE = -1
# Off the tangent plane by more than this many footprints, or so many sigmas of what neighbours usually are.
_LARGEST_STEP, _LARGEST_STEP_SIGMAS = 6.0, 6.0
_STRIP_ROWS = 128

Floats32 = NDArray[np.float32]


def grid_triangles(index: Ints, points: Floats, normals: Floats, focal_px: float) -> Ints:
    """Triangles (T, 3) of indices into `points`, their corners counter-clockwise as seen by the camera.

    `index` (H, W): which point each pixel has, `NONE` for none. `points` (N, 3) in the camera's frame, `normals` (N, 3)
    of unit length. Each square of four neighbouring pixels gives two triangles, one if three of its pixels have points.
    """
    footprint = points[:, 2] / focal_px
    scaled = (points.astype(np.float32), normals.astype(np.float32), footprint.astype(np.float32))
    limit = max(_LARGEST_STEP, _LARGEST_STEP_SIGMAS * _usual_step(index, *scaled))
    strips = [
        _strip_triangles(index[top : top + _STRIP_ROWS + 1], *scaled, limit)
        for top in range(0, max(1, len(index) - 1), _STRIP_ROWS)
    ]
    return np.concatenate(strips)


def _usual_step(index: Ints, points: Floats32, normals: Floats32, footprint: Floats32) -> float:
    """Standard deviation of the steps between horizontal neighbours, in footprints, occlusion edges left aside."""
    steps = _steps(index[:, :-1], index[:, 1:], points, normals, footprint)
    there = steps[np.isfinite(steps)]
    return SIGMA_PER_MEDIAN * float(np.median(there)) if len(there) else 0.0


def _steps(p: Ints, q: Ints, points: Floats32, normals: Floats32, footprint: Floats32) -> Floats32:
    """How far each of two points lies off the other's tangent plane, the larger, in footprints; infinite for none."""
    there = (p != NONE) & (q != NONE)
    a, b = p[there], q[there]
    apart = points[b] - points[a]
    off = np.maximum(np.abs(np.einsum("ni,ni->n", normals[a], apart)), np.abs(np.einsum("ni,ni->n", normals[b], apart)))
    steps = np.full(p.shape, np.inf, np.float32)
    steps[there] = off / np.minimum(footprint[a], footprint[b])
    return steps


def _strip_triangles(index: Ints, points: Floats32, normals: Floats32, footprint: Floats32, limit: float) -> Ints:
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    ab, cd, ac, bd, ad, bc = (
        _steps(p, q, points, normals, footprint) for p, q in ((a, b), (c, d), (a, c), (b, d), (a, d), (b, c))
    )
    falling = ad < bc  # the diagonal from the top left to the bottom right is the smoother one
    uncut: tuple[tuple[tuple[Ints, Ints, Ints], Bools], ...] = (
        ((a, c, d), falling & (np.maximum(np.maximum(ac, cd), ad) <= limit)),
        ((a, d, b), falling & (np.maximum(np.maximum(ad, bd), ab) <= limit)),
        ((a, c, b), ~falling & (np.maximum(np.maximum(ac, bc), ab) <= limit)),
        ((b, c, d), ~falling & (np.maximum(np.maximum(bc, cd), bd) <= limit)),
    )
    return np.concatenate([np.stack([corner[kept] for corner in corners], axis=1) for corners, kept in uncut])
