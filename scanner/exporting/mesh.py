"""The surface as triangles, written as PLY, OBJ or GLB."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints
from calib.pointcloud import SeenPoints, image_triangles
from scanner.errors import InputError
from scanner.results import FinishedScan

# The camera's axes (x right, y down, z forward) turned to x right, y up, z backward, as glTF's cameras look.
Y_UP_FROM_CAMERA = np.array([1.0, -1.0, -1.0])
_OBJ_LINES = 100_000


@dataclass(frozen=True)
class Mesh:
    """`points` and `normals` (N, 3) in the camera's frame and `unit`, `colours` (N, 3) RGB, `triangles` (T, 3).

    Triangles are counter-clockwise as seen by the camera.
    """

    points: Floats
    normals: Floats
    colours: NDArray[np.uint8]
    triangles: Ints
    unit: str


def build_mesh(scan: FinishedScan) -> Mesh:
    """Join neighbouring pixels; points in no triangle are left out. Raises InputError if there is no triangle."""
    focal_px = float(np.mean(scan.calibration.camera.focal_px))
    seen = SeenPoints(scan.matches.camera_px, scan.points, scan.normals, focal_px)
    triangles = image_triangles(seen, scan.index_grid)
    if len(triangles) == 0:
        raise InputError(
            "no three points are neighbours on a surface, so there is nothing to make a mesh of: export the cloud as "
            "ply instead"
        )
    used = np.zeros(len(scan.points), dtype=np.bool_)
    used[triangles.ravel()] = True
    corners = (np.cumsum(used, dtype=np.int32) - np.int32(1))[triangles]
    return Mesh(scan.points[used], scan.normals[used], scan.colours[used], corners, scan.unit)


def write_mesh_ply(path: Path, mesh: Mesh) -> None:
    """Binary PLY in the camera's frame, like the cloud. Raises OSError."""
    vertex = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])
    vertices = np.empty(len(mesh.points), vertex)
    vertices["xyz"], vertices["normal"], vertices["rgb"] = mesh.points, mesh.normals, mesh.colours
    faces = np.empty(len(mesh.triangles), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    faces["count"], faces["corners"] = 3, mesh.triangles
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment unit {_one_line(mesh.unit)} (of x, y, z)",
        "comment camera frame: x right, y down, z forward, origin at the camera's centre",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii", errors="replace"))
        file.write(vertices.data)
        file.write(faces.data)


def write_mesh_obj(path: Path, mesh: Mesh) -> None:
    """Wavefront OBJ, y up, with colours behind the coordinates as MeshLab and Blender read them. Raises OSError."""
    points, normals = mesh.points * Y_UP_FROM_CAMERA, mesh.normals * Y_UP_FROM_CAMERA
    corners = mesh.triangles + 1
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# unit {_one_line(mesh.unit)}; x right, y up, z backward, origin at the camera's centre\n")
        for line, table in (
            ("v %.9g %.9g %.9g %.4f %.4f %.4f\n", np.hstack([points, mesh.colours / 255.0])),
            ("vn %.5f %.5f %.5f\n", normals),
            ("f %d//%d %d//%d %d//%d\n", np.repeat(corners, 2, axis=1)),
        ):
            for start in range(0, len(table), _OBJ_LINES):
                rows = table[start : start + _OBJ_LINES]
                file.write(line * len(rows) % tuple(rows.ravel().tolist()))


def _one_line(text: str) -> str:
    return " ".join(text.split())
