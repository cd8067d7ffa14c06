"""Poses of one sampled surface on another, without a first guess: by features, by planes, and from all rotations.

Two oriented points of one surface and their like on the other fix a pose (Drost et al., "Model globally, match locally:
efficient and robust 3D object recognition", 2010). Which points may be alike, FPFH says (Rusu et al., "Fast point
feature histograms (FPFH) for 3D registration", 2009), by Open3D. Walls have no such features, but planes; and smooth
things that overlap widely descend from one of many rotations.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.deferred_imports import open3d
from calib.geometry import Pose
from calib.numerics import Floats, Ints, compiled, distinct
from calib.registration.hypotheses import poses_by_planes
from calib.registration.nearest_field import NearestField, descended, nearest_field, worths
from calib.registration.rotations import even_rotations
from calib.registration.sampled_surface import SampledSurface

_FEATURE_RADII, _FEATURE_NEIGHBOURS = (4.0, 8.0), 100  # cells
_MATCHED, _MATCHES = 400, 3  # points of the second surface; matches of each
_LEAST_APART, _OFF_APART = 6.0, 1.5  # cells: least distance of two points, largest difference of such distances
_OFF_COSINE, _LEAST_ACROSS = 0.25, 0.3
_MOST_POSES = 150_000
_FEW, _SOME, _MANY = 80, 250, 1000  # patches
_PROMISING, _FOLLOWED, _KEPT = 2500, 400, 24
_TURNS = 900
_WIDE = np.array([5.0, 5.0, 4.0, 4.0, 3.0, 3.0, 2.0, 2.0])  # cells
_CLOSE = np.array([2.0, 1.5, 1.5, 1.0, 1.0, 0.7, 0.7, 0.5, 0.5])
_WITHIN = 1.0
_SAME_TURN, _SAME_CELLS = np.radians(4.0), 3.0
_PLANES, _PLANE_SEEDS, _LEAST_PLANE = 12, 300, 0.02  # the last as a share of the samples
_PLANE_COSINE = float(np.cos(np.radians(12.0)))


def surface_poses(first: SampledSurface, second: SampledSurface) -> tuple[Pose, Floats]:
    """Poses (K,) X_first = R X_second + t that are worth a closer look, and what each is worth, best first.

    Both surfaces have the same cell, and their middles near the origin. Raises ImportError where Open3D is missing.
    """
    field = nearest_field(first)
    patches = second.some(_MANY)
    reach = 0.75 * (first.extent + second.extent)
    starts = [
        _most_promising(field, patches, _feature_poses(first, second)),
        _most_promising(field, patches, poses_by_planes(_planes(first), _planes(second), reach, is_upright=False)),
    ]
    turns = even_rotations(_TURNS)
    starts.append(Pose(turns, _middle(first) - turns @ _middle(second)))
    wide, worth = descended(field, patches.some(_SOME).patches, Pose.concatenate(starts), first.cell * _WIDE)
    chosen = _distinct(wide, worth, first.cell, _FOLLOWED)
    close, worth = descended(field, patches.patches, wide[chosen], first.cell * _CLOSE)
    chosen = _distinct(close, worth, first.cell, _KEPT)
    return close[chosen], worth[chosen]


def _distinct(poses: Pose, worth: Floats, cell: float, most: int) -> list[int]:
    order = np.argsort(-worth, kind="stable")
    ordered = poses[order]
    chosen = distinct(len(order), lambda k: ordered.is_near(ordered[k], _SAME_TURN, _SAME_CELLS * cell), most)
    return [int(order[k]) for k in chosen]


def _most_promising(field: NearestField, patches: SampledSurface, poses: Pose) -> Pose:
    """The distinct ones of many poses at which most of the second surface lies on the first."""
    if not len(poses.translation):
        return poses
    cell = patches.cell
    worth = worths(field, patches.some(_FEW).patches, poses, 2 * _WITHIN * cell)
    best = np.argsort(-worth, kind="stable")[:_PROMISING]
    poses = poses[best]
    worth = worths(field, patches.some(_SOME).patches, poses, 2 * _WITHIN * cell)
    return poses[_distinct(poses, worth, cell, _FOLLOWED)]


def _middle(surface: SampledSurface) -> Floats:
    """The middle (3,) of what is probably seen from one side: where lines along normals come closest to each other."""
    some = surface.some(_MANY)
    across = np.eye(3) - some.normals[:, :, None] * some.normals[:, None]
    pull = np.einsum("nij,nj->i", across, some.points) + 0.1 * some.points.sum(axis=0)
    return np.linalg.solve(across.sum(axis=0) + 0.1 * len(across) * np.eye(3), pull)


def _feature_poses(first: SampledSurface, second: SampledSurface) -> Pose:
    """Poses (K,) at which pairs of points with like features meet."""
    own, other = _matches(first, second)
    turns, shifts = np.empty((_MOST_POSES, 3, 3)), np.empty((_MOST_POSES, 3))
    count = _pair_poses(
        first.points[own],
        first.normals[own],
        second.points[other],
        second.normals[other],
        _LEAST_APART * first.cell,
        _OFF_APART * first.cell,
        turns,
        shifts,
    )
    return Pose(turns[:count], shifts[:count])


def _matches(first: SampledSurface, second: SampledSurface) -> tuple[Ints, Ints]:
    """Points with like features, (M,) of either surface, in random order."""
    rng = np.random.default_rng(0)
    own, other = [], []
    for radius in _FEATURE_RADII:
        here, there = (_features(surface, radius * first.cell) for surface in (first, second))
        usual = there.mean(axis=0)
        rare = np.linalg.norm(there - usual, axis=1)
        chosen = np.argsort(-rare * rng.uniform(0.5, 1.0, len(rare)), kind="stable")[:_MATCHED]
        apart = np.sum(here**2, axis=1)[None] - 2 * there[chosen] @ here.T
        count = min(_MATCHES, len(here))
        nearest = np.argpartition(apart, count - 1, axis=1)[:, :count]
        own.append(nearest.ravel())
        other.append(np.repeat(chosen, count))
    order = rng.permutation(sum(map(len, own)))
    return np.concatenate(own)[order], np.concatenate(other)[order]


def _features(surface: SampledSurface, radius: float) -> NDArray[np.float32]:
    """FPFH (N, 33) of the samples."""
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(surface.points))
    cloud.normals = o3d.utility.Vector3dVector(surface.normals)
    around = o3d.geometry.KDTreeSearchParamHybrid(radius, _FEATURE_NEIGHBOURS)
    features: Any = o3d.pipelines.registration.compute_fpfh_feature(cloud, around)
    return np.ascontiguousarray(np.asarray(features.data).T, np.float32)


@compiled
def _pair_poses(
    here: Floats,
    here_normals: Floats,
    there: Floats,
    there_normals: Floats,
    least_apart: float,
    off_apart: float,
    turns: Floats,
    shifts: Floats,
) -> int:
    """Fill in the poses at which two of the matches meet with points and normals; returns their number."""
    count, most = 0, len(turns)
    frames = np.empty((2, 3, 3))
    for a in range(len(here)):
        for b in range(a):
            long = _apart(here, a, b)
            far = _apart(there, a, b)
            if long < least_apart or np.abs(long - far) > off_apart:
                continue
            if np.abs(_cosine(here_normals, a, b) - _cosine(there_normals, a, b)) > _OFF_COSINE:
                continue
            if (
                np.abs(_slope(here, here_normals, a, b, a) / long - _slope(there, there_normals, a, b, a) / far)
                > _OFF_COSINE
            ):
                continue
            if (
                np.abs(_slope(here, here_normals, a, b, b) / long - _slope(there, there_normals, a, b, b) / far)
                > _OFF_COSINE
            ):
                continue
            if not (_frame(here, here_normals, a, b, frames[0]) and _frame(there, there_normals, a, b, frames[1])):
                continue
            for i in range(3):
                for j in range(3):
                    turns[count, i, j] = (
                        frames[0, i, 0] * frames[1, j, 0]
                        + frames[0, i, 1] * frames[1, j, 1]
                        + frames[0, i, 2] * frames[1, j, 2]
                    )
            for i in range(3):
                shift = here[a, i] + here[b, i]
                for j in range(3):
                    shift -= turns[count, i, j] * (there[a, j] + there[b, j])
                shifts[count, i] = shift / 2
            count += 1
            if count == most:
                return count
    return count


@compiled
def _apart(points: Floats, a: int, b: int) -> float:
    """Distance of two points."""
    x, y, z = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    return float(np.sqrt(x * x + y * y + z * z))


@compiled
def _cosine(normals: Floats, a: int, b: int) -> float:
    return float(normals[a, 0] * normals[b, 0] + normals[a, 1] * normals[b, 1] + normals[a, 2] * normals[b, 2])


@compiled
def _slope(points: Floats, normals: Floats, a: int, b: int, n: int) -> float:
    """How far two points are apart along the normal of `n`."""
    total = 0.0
    for i in range(3):
        total += (points[b, i] - points[a, i]) * normals[n, i]
    return total


@compiled
def _frame(points: Floats, normals: Floats, a: int, b: int, frame: Floats) -> bool:
    """Fill in the axes (3, 3), columns: from one point to the other, and across it along both normals."""
    long, along = _apart(points, a, b), 0.0
    for i in range(3):
        frame[i, 0] = (points[b, i] - points[a, i]) / long
        frame[i, 1] = normals[a, i] + normals[b, i]
        along += frame[i, 0] * frame[i, 1]
    length = 0.0
    for i in range(3):
        frame[i, 1] -= along * frame[i, 0]
        length += frame[i, 1] ** 2
    if length < _LEAST_ACROSS**2:
        return False
    for i in range(3):
        frame[i, 1] /= np.sqrt(length)
    for i in range(3):
        frame[i, 2] = frame[(i + 1) % 3, 0] * frame[(i + 2) % 3, 1] - frame[(i + 2) % 3, 0] * frame[(i + 1) % 3, 1]
    return True


def _planes(surface: SampledSurface) -> tuple[Floats, Ints]:
    """The largest planes (P, 4), normals and offsets n · x, and the samples on each, (P,)."""
    rng = np.random.default_rng(0)
    free = np.ones(len(surface), np.bool_)
    planes: list[list[float]] = []
    areas: list[int] = []
    for _ in range(_PLANES):
        left = np.flatnonzero(free)
        if len(left) < 3:
            break
        seeds = rng.choice(left, min(_PLANE_SEEDS // (1 + len(planes) // 4), len(left)), replace=False)
        points, normals = surface.points[left], surface.normals[left]
        offset = np.sum(surface.points[seeds] * surface.normals[seeds], axis=1)
        on = (np.abs(points @ surface.normals[seeds].T - offset) < 0.6 * surface.cell) & (
            normals @ surface.normals[seeds].T > _PLANE_COSINE
        )
        best = on[:, int(np.argmax(np.count_nonzero(on, axis=0)))]
        if np.count_nonzero(best) < max(12, _LEAST_PLANE * len(surface)):
            break
        for _ in range(2):
            middle, normal = points[best].mean(axis=0), normals[best].mean(axis=0)
            spread = np.linalg.eigh((points[best] - middle).T @ (points[best] - middle))[1][:, 0]
            normal = spread if spread @ normal > 0 else -spread
            best = (np.abs((points - middle) @ normal) < 0.6 * surface.cell) & (normals @ normal > _PLANE_COSINE)
            if not best.any():
                break
        if not best.any():
            break
        planes.append([*normal, normal @ middle])
        areas.append(int(np.count_nonzero(best)))
        free[left[best]] = False
    return np.reshape(planes, (-1, 4)).astype(np.float64), np.array(areas, np.int64)
