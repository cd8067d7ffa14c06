"""Suggested relative poses from features, without planes: Open3D's FPFH with RANSAC.

Rusu et al., "Fast point feature histograms (FPFH) for 3D registration", 2009. Plain walls have no features; objects do.
"""

from typing import Any

import numpy as np

from calib.geometry import Pose
from calib.numerics import Floats
from calib.open3d_module import open3d
from calib.registration.range_view import Surfaces

_VOXELS_ACROSS = 50
_RADIUS_VOXELS, _NEIGHBOURS = 5.0, 100
_APART_VOXELS, _LIKE_EDGES = 1.5, 0.9
_ITERATIONS, _CONFIDENCE = 50_000, 0.999
_SEEDS = (0, 1, 2)


def shape_poses(first: Surfaces, second: Surfaces) -> list[Pose]:
    """X_first = R X_second + t, as several runs suppose it. Raises ImportError where Open3D cannot be loaded."""
    o3d = open3d()
    voxel = max(_extent(first), _extent(second)) / _VOXELS_ACROSS
    clouds: list[Any] = []
    features: list[Any] = []
    for surfaces in (first, second):
        there = np.isfinite(surfaces.normals[..., 2])
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(surfaces.points[there]))
        cloud.normals = o3d.utility.Vector3dVector(surfaces.normals[there])
        cloud = cloud.voxel_down_sample(voxel)
        cloud.normalize_normals()
        around = o3d.geometry.KDTreeSearchParamHybrid(_RADIUS_VOXELS * voxel, _NEIGHBOURS)
        clouds.append(cloud)
        features.append(o3d.pipelines.registration.compute_fpfh_feature(cloud, around))
    if min(len(cloud.points) for cloud in clouds) < 3:
        return []
    return [_ransac(clouds, features, voxel, seed) for seed in _SEEDS]


def _ransac(clouds: list[Any], features: list[Any], voxel: float, seed: int) -> Pose:
    o3d = open3d()
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed)
    ransac = registration.registration_ransac_based_on_feature_matching(
        clouds[1],
        clouds[0],
        features[1],
        features[0],
        True,
        _APART_VOXELS * voxel,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(_LIKE_EDGES),
            registration.CorrespondenceCheckerBasedOnDistance(_APART_VOXELS * voxel),
        ],
        registration.RANSACConvergenceCriteria(_ITERATIONS, _CONFIDENCE),
    )
    pose: Floats = np.asarray(ransac.transformation, np.float64)
    return Pose(pose[:3, :3].copy(), pose[:3, 3].copy())


def _extent(surfaces: Surfaces) -> float:
    """How large the greater part of a station's surfaces is."""
    low, high = np.percentile(surfaces.patches, (5, 95), axis=0)
    return float(np.linalg.norm(high - low))
