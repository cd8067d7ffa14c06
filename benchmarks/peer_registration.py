"""Peers of the registration of clouds without a first guess, each as its own example uses it.

Open3D: FPFH, RANSAC, point to plane. KISS-Matcher (Lim et al., ICRA 2025) alone, and refined by small_gicp (Koide, JOSS
2024). Voxels are a fortieth of the smaller cloud, as this program's coarse cells.
"""

from collections.abc import Callable
from typing import NamedTuple

import kiss_matcher
import numpy as np
import small_gicp

from calib.deferred_imports import open3d
from calib.geometry import Pose
from calib.numerics import Floats
from calib.registration import SurfacePoints, extent_of

_ACROSS = 40.0
_KISS_VOXEL = 0.3  # it refuses voxels of some millimetres of a metre, so clouds are enlarged to its default
_FITNESS = 0.3  # share of points with a counterpart, from which Open3D's documentation calls a result good


class PeerAnswer(NamedTuple):
    """A peer's pose of the second cloud on the first one, and whether it says that this is one."""

    pose: Pose
    valid: bool


def voxel_of(first: SurfacePoints, second: SurfacePoints) -> float:
    """Edge of a voxel for two clouds."""
    return min(extent_of(side.points) for side in (first, second)) / _ACROSS


def by_open3d(first: SurfacePoints, second: SurfacePoints) -> PeerAnswer:
    """Global registration by features, then by all points."""
    o3d, voxel = open3d(), voxel_of(first, second)
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(0)
    clouds, features = [], []
    for side in (first, second):
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(side.points)).voxel_down_sample(voxel)
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(2 * voxel, 30))
        cloud.orient_normals_towards_camera_location(np.zeros(3) if side.eye is None else side.eye)
        around = o3d.geometry.KDTreeSearchParamHybrid(5 * voxel, 100)
        clouds.append(cloud)
        features.append(registration.compute_fpfh_feature(cloud, around))
    rough = registration.registration_ransac_based_on_feature_matching(
        clouds[1],
        clouds[0],
        features[1],
        features[0],
        True,
        1.5 * voxel,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(1.5 * voxel),
        ],
        registration.RANSACConvergenceCriteria(100_000, 0.999),
    )
    fine = registration.registration_icp(
        clouds[1],
        clouds[0],
        0.4 * voxel,
        rough.transformation,
        registration.TransformationEstimationPointToPlane(),
    )
    return PeerAnswer(_pose(np.asarray(fine.transformation)), rough.fitness > _FITNESS)


def by_kiss_matcher(first: SurfacePoints, second: SurfacePoints) -> PeerAnswer:
    """Global registration by features alone."""
    factor = _KISS_VOXEL / voxel_of(first, second)
    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(_KISS_VOXEL))
    target, source = ((factor * side.points).astype(np.float32) for side in (first, second))
    solution = matcher.estimate(source, target)
    rotation, translation = (np.asarray(part, np.float64) for part in (solution.rotation, solution.translation))
    return PeerAnswer(Pose(rotation, translation.reshape(3) / factor), bool(solution.valid))


def by_kiss_and_gicp(first: SurfacePoints, second: SurfacePoints) -> PeerAnswer:
    """The same, refined by the distances of all points; valid if that converged as well."""
    answer, voxel = by_kiss_matcher(first, second), voxel_of(first, second)
    fine = small_gicp.align(
        first.points,
        second.points,
        answer.pose.matrix,
        downsampling_resolution=voxel / 2,
        max_correspondence_distance=voxel,
        rotation_epsilon=1e-4,
        translation_epsilon=1e-3 * voxel,
        max_iterations=100,
    )
    return PeerAnswer(_pose(np.asarray(fine.T_target_source)), answer.valid and bool(fine.converged))


def _pose(matrix: Floats) -> Pose:
    return Pose(matrix[:3, :3].copy(), matrix[:3, 3].copy())


PEERS: dict[str, Callable[[SurfacePoints, SurfacePoints], PeerAnswer]] = {
    "Open3D": by_open3d,
    "KISS-Matcher": by_kiss_matcher,
    "KISS + small_gicp": by_kiss_and_gicp,
}
