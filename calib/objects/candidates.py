"""Supposed poses of two views without a first guess: pairs of points that look alike, and keep their distances.

Points look alike by their surroundings' shape (FPFH: Rusu et al. 2009, by Open3D) or by what the pictures show there
(SIFT: Lowe 2004). Most pairs are wrong. A turn and a shift keep distances, so right pairs are compatible with each
other; pairs that are compatible with the same others vote for one pose (Chen et al., "SC²-PCR: a second order spatial
compatibility for efficient and robust point cloud registration", 2022).
"""

from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from calib.geometry import Motion
from calib.numerics import Floats, Ints
from calib.numerics.open3d_module import open3d
from calib.objects.meeting import mark_pairs
from calib.objects.view import View

_VOXEL, _RADIUS, _NEIGHBOURS = 2.0, 10.0, 100  # grains
_MOST = 500
_COMPATIBLE, _FAR = 1.5, 5.0  # grains: how much distances may differ, and how far apart points are at least
_SEEDS, _VOTERS, _KEPT = 30, 12, 6
_FEWEST = 3


def supposed_poses(first: View, second: View) -> list[Motion]:
    """X_first = R X_second + t, most probable first; and that hardly anything moved."""
    still = Motion(np.eye(3), np.zeros(3))
    own, other = mark_pairs(first, second)
    by_marks = _voted(first.marks.points[own], second.marks.points[other], first.grain)
    here, there = features(first), features(second)
    one, two = _mutual(here[1], there[1])
    by_shape = _voted(here[0][one], there[0][two], first.grain)
    return [still, *by_marks, *by_shape]


@lru_cache(maxsize=512)
def features(view: View) -> tuple[Floats, Floats]:
    """Points (N, 3) and what is around them (N, 33). Raises ImportError where Open3D cannot be loaded."""
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(view.patch_points))
    cloud.normals = o3d.utility.Vector3dVector(view.patch_normals)
    cloud = cloud.voxel_down_sample(_VOXEL * view.grain)
    cloud.normalize_normals()
    around = o3d.geometry.KDTreeSearchParamHybrid(_RADIUS * view.grain, _NEIGHBOURS)
    found: Any = o3d.pipelines.registration.compute_fpfh_feature(cloud, around)
    return np.asarray(cloud.points).astype(np.float64), np.asarray(found.data).T.astype(np.float64)


def _mutual(one: Floats, other: Floats) -> tuple[Ints, Ints]:
    """Each other's nearest, (M,) of either, the most alike of them."""
    if min(len(one), len(other)) < _FEWEST:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    distances, nearest = cKDTree(other).query(one)
    apart, there = np.asarray(distances), np.asarray(nearest, np.int64)
    _, back = cKDTree(one).query(other)
    own = np.flatnonzero(np.asarray(back)[there] == np.arange(len(one)))
    own = own[np.argsort(apart[own])[:_MOST]]
    return own, there[own]


def _voted(here: Floats, there: Floats, grain: float) -> list[Motion]:
    """Of pairs of points (N, 3)."""
    if len(here) < _FEWEST:
        return []
    apart, beyond = (np.linalg.norm(each[:, None] - each, axis=2) for each in (here, there))
    compatible = (np.abs(apart - beyond) < _COMPATIBLE * grain) & (np.minimum(apart, beyond) > _FAR * grain)
    first = compatible.astype(np.float32)
    second = first * (first @ first)
    found: list[tuple[int, Motion]] = []
    for seed in np.argsort(-second.sum(axis=1))[:_SEEDS]:
        voters = np.argsort(-second[seed])[:_VOTERS]
        voters = np.append(voters[second[seed][voters] > 0], seed)
        if len(voters) < _FEWEST:
            continue
        pose = _rigid(here[voters], there[voters])
        for _ in range(2):
            near = np.linalg.norm(there @ pose.rotation.T + pose.translation - here, axis=1) < _COMPATIBLE * grain
            if np.count_nonzero(near) >= _FEWEST:
                pose = _rigid(here[near], there[near])
        if not any(near_each_other(pose, other, grain) for _, other in found):
            found.append((int(np.count_nonzero(near)), pose))
    return [pose for _, pose in sorted(found, key=lambda each: -each[0])[:_KEPT]]


def near_each_other(one: Motion, other: Motion, grain: float) -> bool:
    """Whether two poses are about the same."""
    cosine = (float(np.trace(one.rotation.T @ other.rotation)) - 1) / 2
    return cosine > np.cos(np.radians(6.0)) and float(np.linalg.norm(one.translation - other.translation)) < 8 * grain


def _rigid(here: Floats, there: Floats) -> Motion:
    """The motion of `there` (N, 3) onto `here` (Kabsch 1976)."""
    middle, other = here.mean(axis=0), there.mean(axis=0)
    u, _, vt = np.linalg.svd((here - middle).T @ (there - other))
    rotation = u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))]) @ vt
    return Motion(rotation, middle - rotation @ other)
