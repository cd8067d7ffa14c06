"""The surface as triangles, written as PLY, OBJ or GLB, by the name's ending."""

from pathlib import Path

import numpy as np

from scanner.exporting.formats import Request
from scanner.exporting.glb import write_glb
from scanner.exporting.triangles import Y_UP_FROM_CAMERA, Mesh, build_mesh
from scanner.exporting.units import in_metres
from scanner.io import new_file
from scanner.quantities import unit_name
from scanner.results import read_finished_scan

_OBJ_LINES = 100_000


def export(request: Request) -> list[str]:
    """Write the triangles. Raises InputError and OSError."""
    scan = read_finished_scan(request.result)
    mesh = build_mesh(scan)
    unit, remarks = unit_name(scan.unit), list[str]()
    with new_file(request.out, overwrite=request.overwrite) as path:
        match path.suffix.lower():
            case ".glb":
                metres, remarks = in_metres(scan.unit)
                unit = "metres"
                write_glb(path, mesh, metres)
            case ".ply":
                write_mesh_ply(path, mesh)
            case _:
                write_mesh_obj(path, mesh)
    return [f"{len(mesh.triangles):,} triangles between {len(mesh.points):,} points, in {unit}", *remarks]


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
