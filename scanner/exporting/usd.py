"""The surface as a USD mesh in text (usda): y up, in metres, colours as the primvar displayColor.

https://openusd.org/release/spec_usdpreviewsurface.html and the schema UsdGeomMesh.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.numerics import slices_of
from scanner.cleaning import read_cleaned
from scanner.exporting.formats import ExportRequest
from scanner.exporting.result_mesh import mesh_of_result
from scanner.exporting.triangles import Y_UP_FROM_CAMERA, Mesh, linear_light
from scanner.exporting.units import in_metres, noted
from scanner.io import new_file

_AT_ONCE = 50_000  # rows in memory as they are written
_HEAD = """#usda 1.0
(
    defaultPrim = "scan"
    metersPerUnit = 1
    upAxis = "Y"
)

def Mesh "scan"
{
    uniform token subdivisionScheme = "none"
    uniform bool doubleSided = 1
"""


def export(request: ExportRequest) -> list[str]:
    """Write the triangles. Raises InputError and OSError."""
    result = read_cleaned(request.result, request.capture)
    mesh = mesh_of_result(result, coloured=True)
    metres, findings = in_metres(result.unit)
    with new_file(request.out, overwrite=request.overwrite) as path:
        write_usd(path, mesh, metres)
    triangles = f"{len(mesh.triangles):,} triangles between {len(mesh.points):,} points"
    return [f"{triangles}{result.of_how_many}, in metres", *noted(findings)]


def write_usd(path: Path, mesh: Mesh, metres_per_unit: float) -> None:
    """Write positions in metres, normals, colours and triangles. Raises OSError."""
    points = metres_per_unit * mesh.points * Y_UP_FROM_CAMERA
    with path.open("w", encoding="utf-8") as file:
        file.write(_HEAD)
        low, high = (_vectors(edge[None], 7) for edge in (points.min(axis=0), points.max(axis=0)))
        file.write(f"    float3[] extent = [{low}, {high}]\n")
        for name, end, pieces in (
            ("point3f[] points", "", _in_pieces(points, 7)),
            ("normal3f[] normals", ' (interpolation = "vertex")', _in_pieces(mesh.normals * Y_UP_FROM_CAMERA, 5)),
            (
                "color3f[] primvars:displayColor",
                ' (interpolation = "vertex")',
                _in_pieces(linear_light()[mesh.colours], 5),
            ),
            ("int[] faceVertexCounts", "", (", ".join(["3"] * (some.stop - some.start)) for some in _slices(mesh))),
            ("int[] faceVertexIndices", "", (_numbers(mesh.triangles[some]) for some in _slices(mesh))),
        ):
            file.write(f"    {name} = [")
            for number, piece in enumerate(pieces):
                file.write(f"{', ' if number else ''}{piece}")
            file.write(f"]{end}\n")
        file.write("}\n")


def _slices(mesh: Mesh) -> Iterator[slice]:
    yield from slices_of(len(mesh.triangles), _AT_ONCE)


def _in_pieces(rows: NDArray[np.floating], digits: int) -> Iterator[str]:
    return (_vectors(rows[some], digits) for some in slices_of(len(rows), _AT_ONCE))


def _vectors(rows: NDArray[np.floating], digits: int) -> str:
    return ", ".join(f"({x:.{digits}g}, {y:.{digits}g}, {z:.{digits}g})" for x, y, z in rows.tolist())


def _numbers(corners: NDArray[np.integer]) -> str:
    return ", ".join(map(str, corners.ravel().tolist()))
