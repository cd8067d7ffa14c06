"""Clouds and meshes as files of other programs."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calib.deferred_imports import open3d
from calib.numerics import Floats
from tests.support.blob import Blob


def write_mesh(path: Path, body: Blob, factor: float = 1.0) -> Path:
    o3d = open3d()
    vertices, triangles = body.mesh(30_000)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(factor * vertices), o3d.utility.Vector3iVector(triangles.astype(np.int32))
    )
    o3d.io.write_triangle_mesh(str(path), mesh.compute_triangle_normals())
    return path


def write_cloud(path: Path, points: Floats, normals: Floats, factor: float = 1.0, seed: int = 0) -> Path:
    """Somewhere else, as ASCII PLY without a unit."""
    o3d, rng = open3d(), np.random.default_rng(seed)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.uniform(-300, 300, 3)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(factor * (points @ turn.T + shift)))
    cloud.normals = o3d.utility.Vector3dVector(normals @ turn.T)
    o3d.io.write_point_cloud(str(path), cloud)
    return path
