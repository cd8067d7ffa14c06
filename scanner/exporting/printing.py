"""Triangles for printers, z up, in millimetres: binary STL, or 3MF (3MF core specification 1.3), which states its unit.

Of rooms and things these are the triangles of the result, joined where its pieces, one for each picture, meet.
"""

import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.numerics import Floats, Ints, slices_of
from scanner.cleaning import read_cleaned
from scanner.exporting.formats import ExportRequest
from scanner.exporting.result_mesh import mesh_of_result
from scanner.exporting.triangles import Y_UP_FROM_CAMERA
from scanner.exporting.units import in_metres, noted
from scanner.io import new_file

_MM = 1000.0
_AT_ONCE = 50_000  # triangles, or points, in memory as they are written
_LONGEST_VERTEX, _LONGEST_TRIANGLE = 80, 60  # bytes of a 3MF's model
_MODEL = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
_RELATIONS = (
    '<?xml version="1.0" encoding="UTF-8"?>'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
    'Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>"
)


def export(request: ExportRequest) -> list[str]:
    """Write the triangles. Raises InputError and OSError."""
    result = read_cleaned(request.result, request.capture)
    metres, findings = in_metres(result.unit)
    mesh = mesh_of_result(result)
    points, triangles = metres * mesh.points * Y_UP_FROM_CAMERA, mesh.triangles
    points = _MM * points[:, [0, 2, 1]] * [1.0, -1.0, 1.0]  # y up to z up
    with new_file(request.out, overwrite=request.overwrite) as path:
        if path.suffix.lower() == ".stl":
            write_stl(path, points, triangles)
        else:
            write_3mf(path, points, triangles)
    return [f"{len(triangles):,} triangles{result.of_how_many}, in millimetres", *noted(findings)]


def write_stl(path: Path, points: Floats, triangles: Ints) -> None:
    """Binary STL: no unit, no vertices in common. Raises OSError."""
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    with path.open("wb") as file:
        file.write(b"roomscan, millimetres".ljust(80) + len(triangles).to_bytes(4, "little"))
        for some in slices_of(len(triangles), _AT_ONCE):
            corners = points[triangles[some]]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            rows = np.zeros(len(corners), kind)
            rows["normal"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
            rows["corners"] = corners
            file.write(rows.tobytes())


def write_3mf(path: Path, points: Floats, triangles: Ints) -> None:
    """Raises OSError."""
    # Some readers do not know the extension for large files, so that it is left out where it is not needed.
    is_large = _LONGEST_VERTEX * len(points) + _LONGEST_TRIANGLE * len(triangles) > zipfile.ZIP64_LIMIT
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("[Content_Types].xml", _TYPES)
        file.writestr("_rels/.rels", _RELATIONS)
        with file.open("3D/3dmodel.model", "w", force_zip64=is_large) as model:
            for text in _model_text(points, triangles):
                model.write(text.encode())


def _model_text(points: Floats, triangles: Ints) -> Iterator[str]:
    """The model, in pieces."""
    yield (
        f'<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" xml:lang="en-US" xmlns="{_MODEL}"><resources>'
        '<object id="1" type="model"><mesh><vertices>'
    )
    for some in slices_of(len(points), _AT_ONCE):
        yield "".join(f'<vertex x="{x:.5f}" y="{y:.5f}" z="{z:.5f}"/>' for x, y, z in points[some].tolist())
    yield "</vertices><triangles>"
    for some in slices_of(len(triangles), _AT_ONCE):
        yield "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles[some].tolist())
    yield '</triangles></mesh></object></resources><build><item objectid="1"/></build></model>'
