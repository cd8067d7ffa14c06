"""Surfaces through points with normals, by Open3D.

Kazhdan and Hoppe, "Screened Poisson surface reconstruction", 2013.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanner.exporting.open3d_module import open3d
from scanner.exporting.triangles import Mesh

_Numbers = NDArray[np.floating]


def reconstruct_surface(
    points: _Numbers, normals: _Numbers, colours: NDArray[np.uint8], *, depth: int, scale: float
) -> Any:
    """Open3D's mesh of points and normals (N, 3) and RGB (N, 3): 2^`depth` cells to the side of a cube `scale` times as
    large as they reach. Raises InputError if Open3D cannot be loaded.
    """
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    cloud.normals = o3d.utility.Vector3dVector(normals.astype(np.float64))
    cloud.colors = o3d.utility.Vector3dVector(colours / 255.0)
    return o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=depth, scale=scale, n_threads=1)[0]


def mesh_of(mesh: Any, unit: str) -> Mesh:
    """Of Open3D's mesh: the points that triangles use, with normals."""
    mesh.remove_unreferenced_vertices()
    mesh.compute_vertex_normals()
    return Mesh(
        np.asarray(mesh.vertices).astype(np.float64),
        np.asarray(mesh.vertex_normals).astype(np.float64),
        np.rint(255 * np.clip(np.asarray(mesh.vertex_colors), 0, 1)).astype(np.uint8),
        np.asarray(mesh.triangles).astype(np.int64),
        unit,
    )
