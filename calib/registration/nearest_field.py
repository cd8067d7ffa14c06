"""The nearest sample of a surface for every cell of space around it, and thousands of poses compared with it.

A descent costs some tens of microseconds, so every hypothesis can afford one. Distances are between planes: the mean of
both normals makes them exact to the second order on curved surfaces (Rusinkiewicz, "A symmetric objective function for
ICP", 2019).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.numerics import Floats, compiled, in_pieces, inlined
from calib.registration.projection import Patches, add_pair, rotate_vector, step_pose
from calib.registration.sampled_surface import SampledSurface

REACH = 5  # cells around a sample that know it
_MOST_CELLS = 12_000_000
_LIKE = float(np.cos(np.radians(45.0)))
_DAMPING = 1e-4
# What a sample off the surface, but beside it, costs: neither scanner could have seen its own surface behind the other.
_PER_AGAINST = 1.0


class NearestField(NamedTuple):
    """For cells of space the nearest sample of a surface."""

    points: Floats
    """(N, 3): the samples."""
    normals: Floats
    """(N, 3)"""
    nearest: NDArray[np.int32]
    """(X, Y, Z): the number of the nearest sample within `REACH` cells, −1 for none."""
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
    return NearestField(surface.points, surface.normals, index, origin, cell)


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


def worths(field: NearestField, patches: Patches, poses: Pose, within: float) -> Floats:
    """Patches that lie on the surface within a distance, less those beside it, for each of poses (K,): (K,).

    Poses lead from the patches' frame to the surface's.
    """
    worth = np.empty(len(poses.translation))
    turns, shifts = np.ascontiguousarray(poses.rotation), np.ascontiguousarray(poses.translation)
    in_pieces(
        len(worth),
        lambda at: _evaluate(field, patches, turns[at], shifts[at], within, worth[at]),
        width=len(patches.points),
    )
    return worth


def descended(field: NearestField, patches: Patches, poses: Pose, withins: Floats) -> tuple[Pose, Floats]:
    """Poses (K,) after point-to-plane steps, one for each of the distances `withins`, and their worth (K,), as of
    `worths`, before the last step.
    """
    moved, worth = Pose(poses.rotation.copy(), poses.translation.copy()), np.zeros(len(poses.translation))
    in_pieces(
        len(worth),
        lambda at: _descend(field, patches, moved.rotation[at], moved.translation[at], withins, worth[at]),
        width=len(patches.points) * len(withins),
    )
    return moved, worth


@compiled
def _sample_at(field: NearestField, x: float, y: float, z: float) -> int:
    """The number of the sample near a place, −1 for none."""
    a, b, c = (
        np.floor((x - field.origin[0]) / field.cell),
        np.floor((y - field.origin[1]) / field.cell),
        np.floor((z - field.origin[2]) / field.cell),
    )
    shape = field.nearest.shape
    if a < 0 or b < 0 or c < 0 or a >= shape[0] or b >= shape[1] or c >= shape[2]:
        return -1
    return int(field.nearest[int(a), int(b), int(c)])


@inlined
def _paired(
    field: NearestField, r: Floats, t: Floats, patch: Floats, patch_normal: Floats
) -> tuple[int, tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]:
    """The sample that a patch at a pose lies beside, −1 for none; the patch's place and normal there, and its way from
    the sample.
    """
    x, y, z = rotate_vector(r, patch)
    place = x + t[0], y + t[1], z + t[2]
    facing = rotate_vector(r, patch_normal)
    n = _sample_at(field, place[0], place[1], place[2])
    if n < 0:
        return -1, place, facing, place
    way = place[0] - field.points[n, 0], place[1] - field.points[n, 1], place[2] - field.points[n, 2]
    if _product(facing, field.normals[n]) < _LIKE:
        return -1, place, facing, way
    off = _product(way, field.normals[n])
    if way[0] ** 2 + way[1] ** 2 + way[2] ** 2 - off * off > 4 * field.cell * field.cell:
        return -1, place, facing, way
    return n, place, facing, way


@inlined
def _product(one: tuple[float, float, float], other: Floats) -> float:
    return float(one[0] * other[0] + one[1] * other[1] + one[2] * other[2])


@compiled
def _evaluate(
    field: NearestField, patches: Patches, turns: Floats, shifts: Floats, within: float, worth: Floats
) -> None:
    for k in range(len(turns)):
        worth[k] = 0.0
        for m in range(len(patches.points)):
            n, _, _, way = _paired(field, turns[k], shifts[k], patches.points[m], patches.normals[m])
            if n >= 0:
                off = _product(way, field.normals[n])
                worth[k] += 1 - (off / within) ** 2 if np.abs(off) < within else -_PER_AGAINST


@compiled
def _descend(
    field: NearestField, patches: Patches, turns: Floats, shifts: Floats, withins: Floats, worth: Floats
) -> None:
    for k in range(len(turns)):
        r, t = turns[k], shifts[k]
        for within in withins:
            matrix, gradient, centre = np.zeros((6, 6)), np.zeros(6), t.copy()
            worth[k] = 0.0
            for m in range(len(patches.points)):
                n, place, facing, way = _paired(field, r, t, patches.points[m], patches.normals[m])
                if n < 0:
                    continue
                p, q, s = (
                    field.normals[n, 0] + facing[0],
                    field.normals[n, 1] + facing[1],
                    field.normals[n, 2] + facing[2],
                )
                length = np.sqrt(p * p + q * q + s * s)
                p, q, s = p / length, q / length, s / length
                off = way[0] * p + way[1] * q + way[2] * s
                if not np.abs(off) < within:
                    worth[k] -= _PER_AGAINST
                    continue
                share = 1 - (off / within) ** 2
                worth[k] += share
                arm = place[0] - centre[0], place[1] - centre[1], place[2] - centre[2]
                add_pair(matrix, gradient, arm, (p, q, s), off, share * share)
            if step_pose(matrix, gradient, _DAMPING, centre, r, t) == 0:
                break
