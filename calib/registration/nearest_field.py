"""The nearest sample of a surface for every cell of space around it, and thousands of poses compared with it.

A descent costs some tens of microseconds, so every hypothesis can afford one. Distances are between planes: the mean of
both normals makes them exact to the second order on curved surfaces (Rusinkiewicz, "A symmetric objective function for
ICP", 2019).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.numerics import Floats, compiled, inlined
from calib.registration.plane_step import add_pair, step_pose
from calib.registration.range_view import rotate_vector
from calib.registration.sampled_surface import SampledSurface

REACH = 5  # cells around a sample that know it
_MOST_CELLS = 12_000_000
_LIKE = float(np.cos(np.radians(45.0)))
_DAMPING = 1e-4
# What a sample off the surface, but beside it, costs: neither scanner could have seen its own surface behind the other.
_PER_AGAINST = 1.0


@dataclass(frozen=True, eq=False)
class NearestField:
    """For cells of space the nearest sample of a surface."""

    surface: SampledSurface
    index: NDArray[np.int32]
    """(X, Y, Z): of the nearest sample within `REACH` cells, −1 for none."""
    origin: Floats
    """(3,): the corner of the first cell."""
    cell: float
    """Edge of a cell."""


def nearest_field(surface: SampledSurface) -> NearestField:
    """With cells of the size of the surface's, or larger ones where they would be too many."""
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    cell = surface.cell
    while np.prod(np.ceil((high - low) / cell) + 2 * REACH + 1) > _MOST_CELLS:
        cell *= 1.25
    origin = low - REACH * cell
    shape = (np.ceil((high - low) / cell) + 2 * REACH + 1).astype(np.int64)
    index = np.full(tuple(shape.tolist()), -1, np.int32)
    _fill(surface.points, origin, cell, REACH, index, np.full(index.shape, np.inf, np.float32))
    return NearestField(surface, index, origin, cell)


@compiled
def _fill(
    points: Floats, origin: Floats, cell: float, reach: int, index: NDArray[np.int32], best: NDArray[np.float32]
) -> None:
    for n in range(len(points)):
        x, y, z = (
            (points[n, 0] - origin[0]) / cell,
            (points[n, 1] - origin[1]) / cell,
            (points[n, 2] - origin[2]) / cell,
        )
        i, j, k = int(x), int(y), int(z)
        for a in range(max(0, i - reach), min(index.shape[0], i + reach + 1)):
            for b in range(max(0, j - reach), min(index.shape[1], j + reach + 1)):
                for c in range(max(0, k - reach), min(index.shape[2], k + reach + 1)):
                    apart = (a + 0.5 - x) ** 2 + (b + 0.5 - y) ** 2 + (c + 0.5 - z) ** 2
                    if apart < best[a, b, c]:
                        best[a, b, c] = apart
                        index[a, b, c] = n


def worths(field: NearestField, patches: SampledSurface, poses: Pose, within: float) -> Floats:
    """Patches that lie on the surface within a distance, less those beside it, for each of poses (K,): (K,).

    Poses lead from the patches' frame to the surface's.
    """
    worth = np.empty(len(poses.translation))
    _evaluate(
        np.ascontiguousarray(poses.rotation),
        np.ascontiguousarray(poses.translation),
        patches.points,
        patches.normals,
        field.surface.points,
        field.surface.normals,
        field.index,
        field.origin,
        field.cell,
        within,
        worth,
    )
    return worth


def descended(field: NearestField, patches: SampledSurface, poses: Pose, withins: Floats) -> tuple[Pose, Floats]:
    """Poses (K,) after point-to-plane steps, one for each of the distances `withins`, and their worth (K,)."""
    moved, worth = Pose(poses.rotation.copy(), poses.translation.copy()), np.zeros(len(poses.translation))
    _descend(
        moved.rotation,
        moved.translation,
        patches.points,
        patches.normals,
        field.surface.points,
        field.surface.normals,
        field.index,
        field.origin,
        field.cell,
        withins,
        worth,
    )
    return moved, worth


@compiled
def _sample_at(x: float, y: float, z: float, index: NDArray[np.int32], origin: Floats, cell: float) -> int:
    """The number of the sample near a place, −1 for none."""
    a, b, c = np.floor((x - origin[0]) / cell), np.floor((y - origin[1]) / cell), np.floor((z - origin[2]) / cell)
    if a < 0 or b < 0 or c < 0 or a >= index.shape[0] or b >= index.shape[1] or c >= index.shape[2]:
        return -1
    return int(index[int(a), int(b), int(c)])


@inlined
def _paired(
    r: Floats,
    t: Floats,
    patch: Floats,
    patch_normal: Floats,
    points: Floats,
    normals: Floats,
    index: NDArray[np.int32],
    origin: Floats,
    cell: float,
) -> tuple[int, float, float, float, float, float, float]:
    """The sample that a patch at a pose lies beside, −1 for none; and the patch's place and normal there."""
    x, y, z = rotate_vector(r, patch)
    x, y, z = x + t[0], y + t[1], z + t[2]
    n = _sample_at(x, y, z, index, origin, cell)
    if n < 0:
        return -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    e, f, g = rotate_vector(r, patch_normal)
    if e * normals[n, 0] + f * normals[n, 1] + g * normals[n, 2] < _LIKE:
        return -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a, b, c = x - points[n, 0], y - points[n, 1], z - points[n, 2]
    off = a * normals[n, 0] + b * normals[n, 1] + c * normals[n, 2]
    if a * a + b * b + c * c - off * off > 4 * cell * cell:
        return -1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return n, x, y, z, e, f, g


@compiled
def _evaluate(
    turns: Floats,
    shifts: Floats,
    patches: Floats,
    patch_normals: Floats,
    points: Floats,
    normals: Floats,
    index: NDArray[np.int32],
    origin: Floats,
    cell: float,
    within: float,
    worth: Floats,
) -> None:
    for k in range(len(turns)):
        r, t = turns[k], shifts[k]
        total = 0.0
        for m in range(len(patches)):
            n, x, y, z, _, _, _ = _paired(r, t, patches[m], patch_normals[m], points, normals, index, origin, cell)
            if n < 0:
                continue
            a, b, c = x - points[n, 0], y - points[n, 1], z - points[n, 2]
            off = a * normals[n, 0] + b * normals[n, 1] + c * normals[n, 2]
            if np.abs(off) < within:
                total += 1 - (off / within) ** 2
            else:
                total -= _PER_AGAINST
        worth[k] = total


@compiled
def _descend(
    turns: Floats,
    shifts: Floats,
    patches: Floats,
    patch_normals: Floats,
    points: Floats,
    normals: Floats,
    index: NDArray[np.int32],
    origin: Floats,
    cell: float,
    withins: Floats,
    worth: Floats,
) -> None:
    """Move all poses (K, 3, 3), (K, 3) point to plane; `worth` (K,): as of `worths`, before the last step."""
    centre = np.zeros(3)
    for k in range(len(turns)):
        r, t = turns[k], shifts[k]
        for within in withins:
            matrix, gradient = np.zeros((6, 6)), np.zeros(6)
            worth[k] = 0.0
            for axis in range(3):
                centre[axis] = t[axis]
            for m in range(len(patches)):
                n, x, y, z, e, f, g = _paired(r, t, patches[m], patch_normals[m], points, normals, index, origin, cell)
                if n < 0:
                    continue
                a, b, c = x - points[n, 0], y - points[n, 1], z - points[n, 2]
                p, q, s = normals[n, 0] + e, normals[n, 1] + f, normals[n, 2] + g
                length = np.sqrt(p * p + q * q + s * s)
                p, q, s = p / length, q / length, s / length
                off = a * p + b * q + c * s
                if not np.abs(off) < within:
                    worth[k] -= _PER_AGAINST
                    continue
                share = 1 - (off / within) ** 2
                worth[k] += share
                arm = x - centre[0], y - centre[1], z - centre[2]
                add_pair(matrix, gradient, arm, (p, q, s), off, share * share)
            if not step_pose(matrix, gradient, _DAMPING, centre, r, t):
                break
