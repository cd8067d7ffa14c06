"""Poses of one sampled surface on another, without a first guess: by features, by planes, and from all rotations.

Two oriented points of one surface and their like on the other fix a pose (Drost et al., "Model globally, match locally:
efficient and robust 3D object recognition", 2010). Which points may be alike, FPFH says (Rusu et al., "Fast point
feature histograms (FPFH) for 3D registration", 2009), by Open3D. Walls have no such features, but planes; and smooth
things that overlap widely descend from one of many rotations.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.deferred_imports import open3d
from calib.geometry import Pose, cross
from calib.numerics import Bools, Floats, Ints, compiled
from calib.registration.nearest_field import NearestField, descended, nearest_field, worths
from calib.registration.projection import Patches
from calib.registration.sampled_surface import SampledSurface
from calib.registration.segments import Facets, grow_planes
from calib.registration.starting_poses import distinct_poses, even_rotations, poses_by_planes

Features = list[NDArray[np.float32]]
_FEATURE_RADII, _FEATURE_NEIGHBOURS = (4.0, 8.0), 100  # cells
_MATCHED, _MATCHES = 400, 3  # points of the second surface; matches of each
_LEAST_APART, _OFF_APART = 6.0, 1.5  # cells: least distance of two points, largest difference of such distances
_OFF_COSINE, _LEAST_ACROSS = 0.25, 0.3
_MOST_PAIRS, _MOST_POSES = 1_000_000, 150_000
_FEW, _SOME, _MANY = 80, 250, 1000  # patches
_PROMISING, _FOLLOWED, _KEPT = 2500, 400, 24
_TURNS = 900
_WIDE = np.array([5.0, 5.0, 4.0, 4.0, 3.0, 3.0, 2.0, 2.0])  # cells
_CLOSE = np.array([2.0, 1.5, 1.5, 1.0, 1.0, 0.7, 0.7, 0.5, 0.5])
_WITHIN = 1.0
_SAME_TURN, _SAME_CELLS = np.radians(4.0), 3.0
_PLANES, _PLANE_SAMPLES, _LEAST_PLANE = 12, 4000, 0.02  # the last as a share of the samples
_OFF_PLANE = 0.6  # cells


def surface_poses(first: SampledSurface, second: SampledSurface, signs: Sequence[float] = (1.0,)) -> list[Pose]:
    """Poses (K,) X_first = R X_second + t that are worth a closer look, best first, for each of the `signs` of the
    second one's normals.

    Both surfaces have the same cell, and their middles near the origin. Raises ImportError where Open3D is missing.
    """
    field, reach = nearest_field(first), 0.75 * (first.extent + second.extent)
    features, others = _features(first), _features(second)
    planes, (other_planes, areas) = _planes(first), _planes(second)
    by_sign = []
    for sign in signs:
        turned = second if sign > 0 else second.flipped
        patches = turned.some(_MANY)
        by_planes = poses_by_planes(planes, (sign * other_planes, areas), reach, is_upright=False)
        turns = even_rotations(_TURNS)
        middles = [surface.some(_MANY).patches.normal_centre(0.0) for surface in (first, turned)]
        starts = [
            _most_promising(
                field, patches, _feature_poses(first, features, turned, others if sign > 0 else _flipped(others))
            ),
            _most_promising(field, patches, by_planes),
            Pose(turns, middles[0] - turns @ middles[1]),
        ]
        wide, worth = descended(field, patches.some(_SOME).patches, Pose.concatenate(starts), first.cell * _WIDE)
        chosen = distinct_poses(wide, worth, _SAME_TURN, _SAME_CELLS * first.cell, _FOLLOWED)
        close, worth = descended(field, patches.patches, wide[chosen], first.cell * _CLOSE)
        chosen = distinct_poses(close, worth, _SAME_TURN, _SAME_CELLS * first.cell, _KEPT)
        by_sign.append(close[chosen])
    return by_sign


def _most_promising(field: NearestField, patches: SampledSurface, poses: Pose) -> Pose:
    """The distinct ones of many poses at which most of the second surface lies on the first."""
    if not len(poses.translation):
        return poses
    cell = patches.cell
    worth = worths(field, patches.some(_FEW).patches, poses, 2 * _WITHIN * cell)
    best = np.argsort(-worth, kind="stable")[:_PROMISING]
    poses = poses[best]
    worth = worths(field, patches.some(_SOME).patches, poses, 2 * _WITHIN * cell)
    return poses[distinct_poses(poses, worth, _SAME_TURN, _SAME_CELLS * cell, _FOLLOWED)]


def _feature_poses(first: SampledSurface, features: Features, second: SampledSurface, others: Features) -> Pose:
    """Poses (K,) at which pairs of points with like features meet."""
    own, theirs = _matches(features, others)
    here, there = first.part(own), second.part(theirs)
    pairs = np.empty((_MOST_POSES, 2), np.int32)
    a, b = pairs[: _congruent_pairs(here.patches, there.patches, first.cell, pairs)].T
    (to, is_wide), (of, is_also_wide) = (_frames(side, a, b) for side in (here, there))
    wide = is_wide & is_also_wide
    turns = to[wide] @ of[wide].transpose(0, 2, 1)
    middles = [(side.points[a] + side.points[b])[wide] / 2 for side in (here, there)]
    return Pose(turns, middles[0] - np.einsum("kij,kj->ki", turns, middles[1]))


@compiled
def _congruent_pairs(here: Patches, there: Patches, cell: float, pairs: NDArray[np.int32]) -> int:
    """Fill in the numbers (K, 2) of matches whose points are as far apart on either surface, with normals at like
    angles to each other and to the way between them; returns how many.
    """
    count = examined = 0
    for a in range(len(here.points)):
        for b in range(a):
            long = far = 0.0
            for axis in range(3):
                long += (here.points[b, axis] - here.points[a, axis]) ** 2
                far += (there.points[b, axis] - there.points[a, axis]) ** 2
            long, far = np.sqrt(long), np.sqrt(far)
            if long < _LEAST_APART * cell or np.abs(long - far) > _OFF_APART * cell:
                continue
            examined += 1
            between = along_one = along_other = 0.0
            for axis in range(3):
                way = (here.points[b, axis] - here.points[a, axis]) / long
                run = (there.points[b, axis] - there.points[a, axis]) / far
                normal, next_normal = here.normals[a, axis], here.normals[b, axis]
                its, others = there.normals[a, axis], there.normals[b, axis]
                between += normal * next_normal - its * others
                along_one += way * normal - run * its
                along_other += way * next_normal - run * others
            if max(np.abs(between), np.abs(along_one), np.abs(along_other)) <= _OFF_COSINE:
                pairs[count, 0], pairs[count, 1] = a, b
                count += 1
            if count == len(pairs) or examined == _MOST_PAIRS:
                return count
    return count


def _frames(surface: SampledSurface, a: Ints, b: Ints) -> tuple[Floats, Bools]:
    """Axes (K, 3, 3), columns: from one point to the other, across it along both normals, and the third; and whether
    the normals are across it (K,).
    """
    along = surface.points[b] - surface.points[a]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = surface.normals[a] + surface.normals[b]
    across -= np.sum(across * along, axis=1, keepdims=True) * along
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across /= np.maximum(length, 1e-12)
    return np.stack([along, across, cross(along, across)], axis=-1), length[:, 0] >= _LEAST_ACROSS


def _matches(first: Features, second: Features) -> tuple[Ints, Ints]:
    """Points with like features, (M,) of either surface, in random order."""
    rng = np.random.default_rng(0)
    own, theirs = [], []
    for here, there in zip(first, second, strict=True):
        usual = there.mean(axis=0)
        rare = np.linalg.norm(there - usual, axis=1)
        chosen = np.argsort(-rare * rng.uniform(0.5, 1.0, len(rare)), kind="stable")[:_MATCHED]
        apart = np.sum(here**2, axis=1)[None] - 2 * there[chosen] @ here.T
        count = min(_MATCHES, len(here))
        nearest = np.argpartition(apart, count - 1, axis=1)[:, :count]
        own.append(nearest.ravel())
        theirs.append(np.repeat(chosen, count))
    order = rng.permutation(sum(map(len, own)))
    return np.concatenate(own)[order], np.concatenate(theirs)[order]


def _flipped(features: Features) -> Features:
    """Those of normals of the other sign: two of the three angles, 11 bins each, change theirs."""
    angles = [histograms.reshape(-1, 3, 11) for histograms in features]
    return [np.stack([a[:, 0, ::-1], a[:, 1], a[:, 2, ::-1]], axis=1).reshape(-1, 33) for a in angles]


def _features(surface: SampledSurface) -> Features:
    """FPFH (N, 33) of the samples, for each radius."""
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(surface.points))
    cloud.normals = o3d.utility.Vector3dVector(surface.normals)
    features = []
    for radius in _FEATURE_RADII:
        around = o3d.geometry.KDTreeSearchParamHybrid(radius * surface.cell, _FEATURE_NEIGHBOURS)
        feature: Any = o3d.pipelines.registration.compute_fpfh_feature(cloud, around)
        features.append(np.ascontiguousarray(np.asarray(feature.data).T, np.float32))
    return features


def _planes(surface: SampledSurface) -> tuple[Floats, Ints]:
    """The largest planes (P, 4), normals and offsets n · x, and the samples on each, (P,)."""
    some = surface.some(_PLANE_SAMPLES)
    facets = Facets(some.points, some.normals, np.full(len(some), _OFF_PLANE * surface.cell))
    planes = grow_planes(facets, _PLANES, max(12, _LEAST_PLANE * len(some)))
    areas = [np.count_nonzero(facets.on(plane)) for plane in planes]
    return np.array([[*plane.normal, plane.offset] for plane in planes]).reshape(-1, 4), np.array(areas, np.int64)
