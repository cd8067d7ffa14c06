"""Surfaces as triangles: between the pixels of the camera, or through points with normals, by Open3D.

Kazhdan and Hoppe, "Screened Poisson surface reconstruction", 2013.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib import deferred_imports
from calib.geometry import IDENTITY, Pose
from calib.numerics import Floats, Ints
from calib.pointcloud import SeenPoints, image_triangles
from scanner.errors import InputError
from scanner.results import FinishedScan, PlacedScan


def open3d() -> Any:
    """The module, which has no types. Raises InputError that says what to install if it cannot be loaded."""
    try:
        return deferred_imports.open3d()
    except ImportError as error:
        raise InputError(str(error)) from error


# From the camera's axes (x right, y down, z forward) to glTF's (x right, y up, z backward).
Y_UP_FROM_CAMERA = np.array([1.0, -1.0, -1.0])


def linear_light() -> Floats:
    """The light, up to 1, of each of the 256 values of sRGB (IEC 61966-2-1), (256,)."""
    encoded = np.arange(256) / 255
    linear: Floats = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return linear


@dataclass(frozen=True)
class Mesh:
    """Triangles, counter-clockwise as seen by the camera."""

    points: Floats
    """In the camera's frame and `unit`, (N, 3)."""
    normals: Floats
    """(N, 3)."""
    colours: NDArray[np.uint8]
    """RGB, (N, 3)."""
    triangles: Ints
    """Numbers of their points, (T, 3)."""
    unit: str


def build_joint_mesh(placed: Sequence[PlacedScan]) -> Mesh:
    """The triangles of each scan, in the frame of their poses. Raises InputError."""
    meshes = [build_mesh(station.scan, station.place) for station in placed]
    starts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.colours for mesh in meshes]),
        np.concatenate([start + mesh.triangles for start, mesh in zip(starts, meshes, strict=False)]),
        meshes[0].unit,
    )


def build_mesh(scan: FinishedScan, place: Pose = IDENTITY) -> Mesh:
    """Triangles between neighbouring pixels, moved by a pose; points without a triangle are dropped. Raises InputError
    if there is no triangle.
    """
    focal_px = float(np.mean(scan.calibration.camera.focal_px))
    points = SeenPoints(scan.matches.camera_px, scan.points, scan.normals, focal_px)
    triangles = image_triangles(points)
    if len(triangles) == 0:
        raise InputError(
            "no three points are neighbours on a surface, so there is nothing to make a mesh of: export the cloud as "
            "ply instead"
        )
    used = np.zeros(len(scan.points), dtype=np.bool_)
    used[triangles.ravel()] = True
    corners = (np.cumsum(used, dtype=np.int32) - np.int32(1))[triangles]
    return Mesh(place @ scan.points[used], place.rotate(scan.normals[used]), scan.colours[used], corners, scan.unit)


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
