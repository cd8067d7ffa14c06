"""Clouds, meshes and CAD models of any program: PLY, PCD, XYZ, PTS, E57, LAS, LAZ; STL, OBJ, OFF, GLB, 3MF, STEP.

Open3D reads most of them; pye57, laspy and cascadio (optional parts) theirs. What a file says of its unit is kept: E57,
LAS and GLB are in metres by their specifications, 3MF and STEP name their unit, and files of this program have it in
their headers. Points that are no finite numbers are left out.
"""

import os
import re
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from calib.deferred_imports import open3d
from calib.numerics import Bools, Floats, Ints
from hw.optional_parts import E57, LAS, STEP
from scanner.errors import InputError
from scanner.io.free_memory import require_memory
from scanner.io.given_file import megabytes, opened
from scanner.io.measured_points import are_repeated, are_stray, usable_normals
from scanner.io.ply import read_frame
from scanner.io.stored_points import (
    MOST_POINTS,
    StoredPoints,
    ply_header,
    points_of_pcd,
    points_of_ply,
    points_of_text,
)
from scanner.io.wavefront import read_obj

_HEADER = 4096
# Times as far from the middle as nine tenths of the points, from which on nothing is part of them. Of a mesh, most
# corners may be in a detail.
_STRAY, _STRAY_OF_MESH = 1e3, 1e6
_UNIT = re.compile(r"unit ([A-Za-zµμ]+)")
_GROWTH, _GROWTH_OF_TEXT = 8, 16  # bytes of memory for one of the file, at most, as it is read
_PACKED = 40  # the same of compressed files
_UNITS_OF_3MF = {
    "micron": "um",
    "millimeter": "mm",
    "centimeter": "cm",
    "inch": "in",
    "foot": "ft",
    "meter": "m",
}
_CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
_MOST_MODEL_BYTES = 1_000_000_000
# Largest distance of a triangle from a curved face of STEP, and angle between neighbours.
_OFF_FACE_MM, _BETWEEN_TRIANGLES = 0.005, 0.1
_OTHER_CAD = (".iges", ".igs", ".fcstd", ".sldprt", ".dwg", ".dxf")


@dataclass(frozen=True, eq=False)
class StoredSurface:
    """A cloud, or a mesh, as its file has it."""

    points: Floats
    """(N, 3): of the cloud, or the vertices."""
    normals: Floats | None
    """(N, 3) of unit length; None where the file has none."""
    triangles: Ints | None
    """(T, 3): of vertices; None of a cloud."""
    unit: str | None
    """Of the points; None where the file does not say."""
    eye: Floats | None
    """(3,): the scanner's place; None unless all points were seen from one that the file states."""
    dropped: int
    """Points that were no finite numbers."""
    thinned_from: int | None
    """Points of the file, where only some were kept."""
    at_origin: int = 0
    """Points that were left out because they are exactly at (0, 0, 0), where programs put what was not measured."""
    stray: int = 0
    """Points that were left out because they are too far away from all others."""
    repeated: int = 0
    """Points that were left out because others are at exactly the same place."""


def is_surface_file(path: Path) -> bool:
    """Whether a file is, by its name's ending, a cloud, a mesh or a CAD model, readable or not."""
    return path.suffix.lower() in READERS or path.suffix.lower() in _OTHER_CAD


def read_surface(path: Path) -> StoredSurface:
    """Read a cloud or a mesh, by its name's ending. Raises InputError if it is missing, empty, damaged, unknown, too
    large for the memory, or if the library that reads it is not installed.
    """
    kind = path.suffix.lower()
    if kind in _OTHER_CAD:
        raise InputError(
            f"{path}: CAD files of this kind cannot be read: export it from the CAD program as STEP or STL"
        )
    if kind not in READERS:
        raise InputError(
            f"{path}: expected a cloud or a mesh ({', '.join(sorted(READERS))}), found '{kind or 'no ending'}'"
        )
    with opened(path) as file:
        start = file.read(_HEADER)
    if not start:
        raise InputError(f"{path}: is empty: expected a cloud or a mesh")
    surface = READERS[kind](path, start)
    if not len(surface.points):
        raise InputError(f"{path}: holds no point, or is damaged")
    return surface


def _require_memory(path: Path, growth: int) -> None:
    """For a file that is read as a whole."""
    size = path.stat().st_size
    require_memory(growth * size, f"the {megabytes(size)} of {path}", "thin it out before; a cloud, save as binary PLY")


def _open3d() -> Any:
    try:
        return open3d()
    except ImportError as error:
        raise InputError(str(error)) from error


def _stated_unit(start: bytes) -> str | None:
    """The unit in the header of a file of this program."""
    if start.startswith(b"roomscan, millimetres"):
        return "mm"
    match = _UNIT.search(start.decode("utf-8", errors="replace"))
    return match[1] if match else None


def _with(
    points: Floats,
    normals: Floats | None,
    unit: str | None,
    eye: Floats | None = None,
    dropped: int = 0,
    total: int | None = None,
) -> StoredSurface:
    """A cloud of points (N, 3), thinned out and without what cannot have been measured. `total`: points of the file."""
    total = total or len(points)
    step = -(-len(points) // MOST_POINTS) if len(points) > MOST_POINTS else 1
    points = np.asarray(points[::step], np.float64)
    finite: Bools = np.asarray(np.isfinite(points).all(axis=1))
    missing: Bools = finite & np.asarray(~points.any(axis=1))
    if np.count_nonzero(missing) == 1:
        missing = np.zeros_like(missing)
    stray = np.zeros_like(finite)
    measured = finite & ~missing
    stray[measured] = are_stray(points[measured], _STRAY)
    kept = measured & ~stray
    repeated = are_repeated(points[kept])
    kept[kept] = ~repeated
    own = None if normals is None or len(normals) == 0 else usable_normals(points[kept], normals[::step][kept])
    return StoredSurface(
        points[kept],
        own,
        None,
        unit,
        eye,
        dropped + int(np.count_nonzero(~finite)),
        total if total > MOST_POINTS else None,
        int(np.count_nonzero(missing)),
        int(np.count_nonzero(stray)),
        int(np.count_nonzero(repeated)),
    )


def _cloud(path: Path, start: bytes) -> StoredSurface:
    _require_memory(path, _GROWTH)
    o3d = _open3d()
    with _silent():
        cloud = o3d.io.read_point_cloud(str(path), remove_nan_points=False, remove_infinite_points=False)
    return _with(np.asarray(cloud.points), np.asarray(cloud.normals), _stated_unit(start))


def _of_points(stored: StoredPoints, start: bytes, eye: Floats | None = None) -> StoredSurface:
    return _with(stored.points, stored.normals, _stated_unit(start), eye, stored.unreadable, stored.total)


def _text(path: Path, start: bytes) -> StoredSurface:
    return _of_points(points_of_text(path), start)


def _pcd(path: Path, start: bytes) -> StoredSurface:
    stored = points_of_pcd(path)
    return _cloud(path, start) if stored is None else _of_points(stored, start)


def _ply(path: Path, start: bytes) -> StoredSurface:
    header = ply_header(path)
    if faces := header.elements.get("face"):
        return _mesh(path, start, faces)
    if header.vertex is None:  # lists, or something before the vertices
        return _cloud(path, start)
    eye = np.zeros(3) if read_frame(path).startswith("camera frame:") else None
    return _of_points(points_of_ply(path, header), start, eye)


def _off(path: Path, start: bytes) -> StoredSurface:
    words = re.sub(rb"#.*", b"", start).split()
    faces = words[2] if words[:1] == [b"OFF"] and len(words) > 2 else b"0"
    return _mesh(path, start, int(faces) if faces.isdigit() else 0)


def _mesh(path: Path, start: bytes, faces: int = 0) -> StoredSurface:
    """A mesh that has `faces`, each of a triangle or more, if its header says so."""
    _require_memory(path, _GROWTH)
    o3d = _open3d()
    with _silent():
        mesh = o3d.io.read_triangle_mesh(str(path))
    if 0 < len(mesh.triangles) < faces:
        shortfall = f"its header promises {faces:,} faces, and {len(mesh.triangles):,} triangles can be read"
        raise InputError(f"{path}: is truncated or damaged: {shortfall}: copy it again")
    return _triangles_of(path, mesh, "m" if path.suffix.lower() in (".glb", ".gltf") else _stated_unit(start))


def _obj(path: Path, start: bytes) -> StoredSurface:
    _require_memory(path, _GROWTH_OF_TEXT)
    return _triangles(path, *read_obj(path), _stated_unit(start))


def _step(path: Path, _start: bytes) -> StoredSurface:
    """The faces of all parts at their places, as triangles."""
    with STEP.needed("STEP", "cascadio", InputError):
        import cascadio
    _require_memory(path, _PACKED)
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "model.obj"  # in which parts are at their places, in millimetres
        with _silent():
            failed = cascadio.step_to_obj(str(path), str(model), _OFF_FACE_MM, _BETWEEN_TRIANGLES, use_colors=False)
        if failed:
            raise InputError(f"{path}: expected a model as STEP, found a damaged file, or one without a shape")
        return _triangles(path, *read_obj(model), "mm")


@contextmanager
def _silent() -> Iterator[None]:
    """Drop what libraries write by themselves: OpenCASCADE tells errors in colours, RPly without the file's name."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    try:
        with Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        for number, own in enumerate(kept, start=1):
            os.dup2(own, number)
            os.close(own)


def _triangles_of(path: Path, mesh: Any, unit: str | None) -> StoredSurface:
    mesh.remove_duplicated_vertices()
    points, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64)
    return _triangles(path, points, triangles, unit)


def _triangles(path: Path, points: Floats, triangles: Ints, unit: str | None) -> StoredSurface:
    """A mesh without the triangles that have no extent."""
    if not len(triangles):
        kind = path.suffix[1:].upper()
        raise InputError(f"{path}: holds no triangle, or is damaged: expected a mesh as {kind}; export it again")
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(f"{path}: is damaged: triangles of points that it does not have")
    finite: Bools = np.asarray(np.isfinite(points).all(axis=1))
    stray = np.zeros_like(finite)
    stray[finite] = are_stray(points[finite], _STRAY_OF_MESH)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    with np.errstate(invalid="ignore", over="ignore"):
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    kept = triangles[(finite & ~stray)[triangles].all(axis=1) & np.isfinite(area) & (area > 0)]
    if not len(kept):
        raise InputError(f"{path}: holds no triangle that has an area")
    used, corners = np.unique(kept, return_inverse=True)
    lost, away = int(np.count_nonzero(~finite)), int(np.count_nonzero(stray))
    own = corners.reshape(kept.shape).astype(np.int64)
    return StoredSurface(points[used], None, own, unit, None, lost, None, stray=away)


def _3mf(path: Path, _start: bytes) -> StoredSurface:
    """The meshes of all objects of a model, by the 3MF core specification, without their instances' placements."""
    _require_memory(path, _PACKED)
    try:
        with zipfile.ZipFile(path) as file:
            models = [entry for entry in file.infolist() if entry.filename.lower().endswith(".model")]
            if not models:
                raise InputError(f"{path}: holds no model of 3MF")
            if models[0].file_size > _MOST_MODEL_BYTES:
                raise InputError(f"{path}: its model is too large: {megabytes(models[0].file_size)}")
            root = ElementTree.fromstring(file.read(models[0]))
        points, triangles, count = [], [], 0
        for mesh in root.iter(f"{_CORE}mesh"):
            own = [[float(vertex.get(axis, "nan")) for axis in "xyz"] for vertex in mesh.iter(f"{_CORE}vertex")]
            corners = [
                [int(triangle.get(k, "-1")) for k in ("v1", "v2", "v3")] for triangle in mesh.iter(f"{_CORE}triangle")
            ]
            points += own
            triangles.append(np.reshape(corners, (-1, 3)).astype(np.int64) + count)
            count += len(own)
    except (zipfile.BadZipFile, ElementTree.ParseError, ValueError, OSError, KeyError, NotImplementedError) as error:
        raise InputError(f"{path}: expected a model of 3MF, found a damaged file") from error
    if not points or not triangles or not sum(map(len, triangles)):
        raise InputError(f"{path}: holds no triangle")
    unit = _UNITS_OF_3MF.get(root.get("unit", "millimeter"))
    return _triangles(path, np.array(points), np.concatenate(triangles), unit)


def _e57(path: Path, _start: bytes) -> StoredSurface:
    with E57.needed("E57", "pye57", InputError):
        import pye57
    _require_memory(path, _PACKED)
    points, eyes = [], []
    try:
        with pye57.E57(str(path)) as file:
            for number in range(file.scan_count):
                scan = file.read_scan(number, ignore_missing_fields=True, transform=True)
                points.append(np.stack([scan["cartesianX"], scan["cartesianY"], scan["cartesianZ"]], axis=1))
                header = file.get_header(number)
                eyes += [np.asarray(header.translation, np.float64)] if header.has_pose() else []
    except Exception as error:  # libE57's exceptions have no class in common with Python's
        raise InputError(f"{path}: expected a cloud as E57, found a damaged file") from error
    if not points:
        raise InputError(f"{path}: holds no scan")
    eye = eyes[0] if len(eyes) == len(points) == 1 else None  # without a pose, points may be in the frame of anything
    return _with(np.concatenate(points), None, "m", eye)


def _las(path: Path, _start: bytes) -> StoredSurface:
    with LAS.needed("LAS", "laspy", InputError):
        import laspy
    try:
        with laspy.open(str(path)) as file:
            total = int(file.header.point_count)
            step = max(1, -(-total // MOST_POINTS))
            chunks = file.chunk_iterator(1_000_000)
            parts = [np.stack([chunk.x, chunk.y, chunk.z], axis=1)[::step] for chunk in chunks]
    except Exception as error:  # laspy and lazrs have no common class of errors
        raise InputError(f"{path}: expected a cloud as LAS, found a damaged file") from error
    if not parts:
        raise InputError(f"{path}: holds no point")
    return _with(np.concatenate(parts).astype(np.float64), None, "m", total=total)


READERS: dict[str, Callable[[Path, bytes], StoredSurface]] = {
    ".ply": _ply,
    ".pcd": _pcd,
    **dict.fromkeys((".xyz", ".xyzn", ".xyzrgb", ".pts"), _text),
    ".off": _off,
    ".obj": _obj,
    **dict.fromkeys((".stl", ".glb", ".gltf"), _mesh),
    ".3mf": _3mf,
    **dict.fromkeys((".step", ".stp"), _step),
    ".e57": _e57,
    **dict.fromkeys((".las", ".laz"), _las),
}
