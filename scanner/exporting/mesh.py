"""The surface as triangles, written as PLY, OBJ or GLB, by the name's ending."""

from pathlib import Path

import numpy as np

from calib.finding import Finding
from scanner.cleaning import read_cleaned
from scanner.exporting.formats import ExportRequest
from scanner.exporting.glb import write_glb
from scanner.exporting.result_mesh import mesh_of_result
from scanner.exporting.triangles import Y_UP_FROM_CAMERA, Mesh
from scanner.exporting.units import in_metres, noted
from scanner.io import copy_given, new_file, write_ply
from scanner.quantities import unit_name

_OBJ_LINES = 100_000


def export(request: ExportRequest) -> list[str]:
    """Write the triangles. Raises InputError and OSError."""
    result = read_cleaned(request.result, request.capture)
    if result.whole.mesh is not None and not result.steps and request.out.suffix.lower() == ".glb":
        with new_file(request.out, overwrite=request.overwrite) as path:
            copy_given(result.whole.mesh, path)
        return ["the triangles, as they are in the result"]
    mesh = mesh_of_result(result, coloured=True)
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


def write_mesh_obj(path: Path, mesh: Mesh) -> None:
    """Wavefront OBJ, y up, with colours behind the coordinates as MeshLab and Blender read them. Raises OSError."""
    points, normals = mesh.points * Y_UP_FROM_CAMERA, mesh.normals * Y_UP_FROM_CAMERA
    corners = mesh.triangles + 1
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# unit {' '.join(mesh.unit.split())}; x right, y up, z backward\n")
        for line, table in (
            ("v %.9g %.9g %.9g %.4f %.4f %.4f\n", np.hstack([points, mesh.colours / 255.0])),
            ("vn %.5f %.5f %.5f\n", normals),
            ("f %d//%d %d//%d %d//%d\n", np.repeat(corners, 2, axis=1)),
        ):
            for start in range(0, len(table), _OBJ_LINES):
                rows = table[start : start + _OBJ_LINES]
                file.write(line * len(rows) % tuple(rows.ravel().tolist()))
