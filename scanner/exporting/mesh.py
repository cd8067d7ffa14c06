"""The surface as triangles, written as PLY, OBJ or GLB, by the name's ending."""

from pathlib import Path

import numpy as np

from calib.finding import Finding
from scanner.errors import InputError
from scanner.exporting.formats import ExportRequest
from scanner.exporting.glb import write_glb
from scanner.exporting.triangles import Y_UP_FROM_CAMERA, Mesh, build_joint_mesh
from scanner.exporting.units import in_metres, noted
from scanner.io import copy_given, new_file, write_ply
from scanner.quantities import unit_name
from scanner.results import read_finished_result

_OBJ_LINES = 100_000


def export(request: ExportRequest) -> list[str]:
    """Write the triangles. Raises InputError and OSError."""
    result = read_finished_result(request.result, request.capture)
    if result.mesh is not None:
        return _as_it_is(request, result.mesh)
    mesh = build_joint_mesh(result.stations_before_camera)
    unit, findings = unit_name(result.unit), list[Finding]()
    with new_file(request.out, overwrite=request.overwrite) as path:
        match path.suffix.lower():
            case ".glb":
                metres, findings = in_metres(result.unit)
                unit = "metres"
                write_glb(path, mesh, metres)
            case ".ply":
                write_ply(path, mesh, triangles=mesh.triangles)
            case _:
                write_mesh_obj(path, mesh)
    triangles = f"{len(mesh.triangles):,} triangles between {len(mesh.points):,} points"
    return [f"{triangles}{result.of_how_many}, in {unit}", *noted(findings)]


def _as_it_is(request: ExportRequest, mesh: Path) -> list[str]:
    """The mesh of a room or an object is in its result already."""
    if request.out.suffix.lower() != ".glb":
        raise InputError(f"{request.out}: this result's mesh is exported as GLB: choose a name that ends in .glb")
    with new_file(request.out, overwrite=request.overwrite) as path:
        copy_given(mesh, path)
    return ["the triangles, as they are in the result"]


def write_mesh_obj(path: Path, mesh: Mesh) -> None:
    """Wavefront OBJ, y up, with colours behind the coordinates as MeshLab and Blender read them. Raises OSError."""
    points, normals = mesh.points * Y_UP_FROM_CAMERA, mesh.normals * Y_UP_FROM_CAMERA
    corners = mesh.triangles + 1
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# unit {' '.join(mesh.unit.split())}; x right, y up, z backward, origin at the camera's centre\n")
        for line, table in (
            ("v %.9g %.9g %.9g %.4f %.4f %.4f\n", np.hstack([points, mesh.colours / 255.0])),
            ("vn %.5f %.5f %.5f\n", normals),
            ("f %d//%d %d//%d %d//%d\n", np.repeat(corners, 2, axis=1)),
        ):
            for start in range(0, len(table), _OBJ_LINES):
                rows = table[start : start + _OBJ_LINES]
                file.write(line * len(rows) % tuple(rows.ravel().tolist()))
