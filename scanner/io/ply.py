"""Point clouds and meshes as binary PLY (Turk 1994), the way MeshLab, CloudCompare and Open3D read it."""

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints, compiled, in_slices, is_far, slices_of
from scanner.errors import InputError
from scanner.io.given_file import opened, refuse_bomb

Floats32 = NDArray[np.float32]


class _Column(NamedTuple):
    """A vertex property: the array's name, the type of its components, their names in the file."""

    name: str
    kind: str
    components: tuple[str, ...]


_COLUMNS = (
    _Column("points", "float", ("x", "y", "z")),
    _Column("normals", "float", ("nx", "ny", "nz")),
    _Column("colours", "uchar", ("red", "green", "blue")),
)
_MATCH = _Column("match", "int", ("match",))
_TYPES = {
    **dict.fromkeys(("char", "int8"), "<i1"),
    **dict.fromkeys(("uchar", "uint8"), "<u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}
_TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
_PIECE = 1 << 15  # points per write, within the processor's cache
_COUNTED = 1 << 18  # points counted at a time
_LONGEST_HEADER = 1 << 16
_COUNT = re.compile(r"[0-9]{1,12}")
_END = b"end_header\n"
_CAMERA_FRAME = "camera frame: x right, y down, z forward, origin at the camera's centre"
_ROOM_FRAME = "room frame: z up from the floor, x along a wall, origin on the floor below the first station's camera"
_CORNER_FRAME = "corner frame: origin at the corner's vertex, axes along its edges, z along the most upright"


class PointCloud(Protocol):
    """The cloud to write: `points` (NaN for none), `normals` and RGB `colours` (..., 3)."""

    @property
    def points(self) -> NDArray[np.floating]: ...  # noqa: D102
    @property
    def normals(self) -> NDArray[np.floating]: ...  # noqa: D102
    @property
    def colours(self) -> NDArray[np.uint8]: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102


@dataclass(frozen=True)
class CloudPoints:
    """`points` (N, 3), `normals` (N, 3) of unit length, `colours` (N, 3) RGB.

    `match` (N,): the number of the match that each point was triangulated from; None where the file does not say.
    """

    points: Floats
    normals: Floats
    colours: NDArray[np.uint8]
    match: Ints | None

    def __len__(self) -> int:
        return len(self.points)


def write_ply(path: Path, cloud: PointCloud, *, match: Ints | None = None, triangles: Ints | None = None) -> None:
    """Write the points that are there, in the camera's frame, with normals and colours, row by row of its image.

    `match` (...): which match each point was triangulated from; `triangles` (T, 3): between points that are all there.

    Raises OSError if the file cannot be written.
    """
    _write(path, cloud, _CAMERA_FRAME, match, triangles)


def write_merged_ply(path: Path, cloud: PointCloud) -> None:
    """The same for a cloud of several captures, in their corner's frame. Raises OSError."""
    _write(path, cloud, _CORNER_FRAME, None, None)


def write_room_ply(path: Path, cloud: PointCloud, frame: str = _ROOM_FRAME, *, match: Ints | None = None) -> None:
    """The same for a cloud of a whole room, in the room's frame or the one that is described. Raises OSError."""
    _write(path, cloud, frame, match, None)


def read_frame(path: Path) -> str:
    """How a cloud describes its frame; '' where it does not. Raises InputError if it is missing."""
    with opened(path) as file:
        lines = file.read(_LONGEST_HEADER).partition(_END)[0].decode("ascii", errors="replace").splitlines()
    described = [line.removeprefix("comment ") for line in lines if line.startswith("comment ") and " frame: " in line]
    return described[0] if described else ""


def _write(path: Path, cloud: PointCloud, frame: str, match: Ints | None, triangles: Ints | None) -> None:
    columns = _COLUMNS if match is None else (*_COLUMNS, _MATCH)
    points, normals = (np.asarray(array, np.float32).reshape(-1, 3) for array in (cloud.points, cloud.normals))
    colours, numbers = cloud.colours.reshape(-1, 3), None if match is None else np.asarray(match, np.int32).reshape(-1)
    total = sum(in_slices(len(points), _COUNTED, lambda at: int(np.count_nonzero(np.isfinite(points[at, 2])))))
    vertices = np.empty(_PIECE, [(column.name, _TYPES[column.kind], len(column.components)) for column in columns])
    # The unit comes from a user file: it must not end the comment or the header.
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment unit {' '.join(cloud.unit.split())} (of x, y, z)",
        f"comment {frame}",
        f"element vertex {total}",
        *(f"property {column.kind} {name}" for column in columns for name in column.components),
    ]
    if triangles is not None:
        header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii", errors="replace") + _END)
        into = [vertices[column.name].reshape(_PIECE, -1) for column in columns]
        for piece in slices_of(len(points), _PIECE):
            some = None if numbers is None else numbers[piece]
            count = _gather(points[piece], normals[piece], colours[piece], some, into[0], into[1], into[2], into[-1])
            file.write(vertices[:count].data)
        if triangles is not None:
            faces = np.empty(len(triangles), _TRIANGLE)
            faces["count"], faces["corners"] = 3, triangles
            file.write(faces.data)


def write_scalar_ply(
    path: Path,
    points: Floats,
    normals: Floats,
    colours: NDArray[np.uint8],
    scalars: Mapping[str, Floats],
    unit: str,
    frame: str,
) -> None:
    """Points, normals and colours (N, 3) with numbers (N,) by name, which CloudCompare shows as scalar fields.

    Points far from the origin, as in the coordinates of a survey, are in double precision. Raises OSError.
    """
    given = [_COLUMNS[0]._replace(kind="double"), *_COLUMNS[1:]] if is_far(points) else [*_COLUMNS]
    columns = [*given, *(_Column(name, "float", (name,)) for name in scalars)]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment unit {' '.join(unit.split())} (of x, y, z)",
        f"comment {' '.join(frame.split())}",
        f"element vertex {len(points)}",
        *(f"property {column.kind} {name}" for column in columns for name in column.components),
    ]
    kind = [(column.name, _TYPES[column.kind], len(column.components)) for column in columns]
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii", errors="replace") + _END)
        for piece in slices_of(len(points), _PIECE):
            vertices = np.empty(len(points[piece]), kind)
            vertices["points"], vertices["normals"], vertices["colours"] = points[piece], normals[piece], colours[piece]
            for name, values in scalars.items():
                vertices[name] = values[piece, None]
            file.write(vertices.tobytes())


@compiled
def _gather(
    points: Floats32,
    normals: Floats32,
    colours: NDArray[np.uint8],
    match: Ints | None,
    to_points: Floats32,
    to_normals: Floats32,
    to_colours: NDArray[np.uint8],
    to_match: Ints,
) -> int:
    """Copy the points that are there (P, 3), with their normals, colours and matches (P,), to the beginning of arrays
    of the same shapes, at any memory alignment; without matches, nothing goes to the last one. Returns their number.
    """
    count = 0
    for i in range(len(points)):
        if np.isfinite(points[i, 2]):
            for axis in range(3):
                to_points[count, axis] = points[i, axis]
                to_normals[count, axis] = normals[i, axis]
                to_colours[count, axis] = colours[i, axis]
            if match is not None:
                to_match[count, 0] = match[i]
            count += 1
    return count


def read_cloud(path: Path) -> CloudPoints:
    """Read a binary little-endian PLY that begins with its vertices, as `write_ply` makes it.

    Raises InputError if the file is missing, truncated, or lacks coordinates, normals or colours, or if a coordinate is
    no finite number.
    """
    with opened(path) as file:
        start = file.read(_LONGEST_HEADER)
        end = start.find(_END)
        if not start.startswith(b"ply\n") or end < 0:
            raise InputError(f"{path}: expected a PLY file as 'scan' writes it, found something else")
        count, layout = _vertex_layout(path, start[:end].decode("ascii", errors="replace").splitlines())
        size = count * layout.itemsize
        refuse_bomb(path, file, size)
        file.seek(end + len(_END))
        data = file.read(min(size, os.fstat(file.fileno()).st_size))
    if len(data) < size:
        raise InputError(f"{path}: truncated: the header promises {count} points; copy the file again")
    vertices = np.frombuffer(data, layout, count)
    points, normals, colours = (np.stack([vertices[name] for name in column.components], axis=1) for column in _COLUMNS)
    if not np.isfinite(points).all():
        raise InputError(f"{path}: damaged: the coordinates of a point are no finite numbers")
    match = vertices[_MATCH.name] if _MATCH.name in (layout.names or ()) else None
    if match is not None and match.dtype.kind not in "iu":
        raise InputError(f"{path}: expected the numbers of matches to be whole, found {match.dtype}")
    with np.errstate(invalid="ignore"):  # invalid colours become some colour
        rgb = colours.astype(np.uint8)
    whole = None if match is None else match.astype(np.int64)
    return CloudPoints(points.astype(np.float64), normals.astype(np.float64), rgb, whole)


def _vertex_layout(path: Path, header: list[str]) -> tuple[int, np.dtype[np.void]]:
    """Return the number of vertices and the type of one."""
    words = [line.split() for line in header if line.split()]
    elements = [index for index, line in enumerate(words) if line[0] == "element" and len(line) == 3]
    count = words[elements[0]][2] if elements and words[elements[0]][1] == "vertex" else ""
    if ["format", "binary_little_endian", "1.0"] not in words or not _COUNT.fullmatch(count):
        raise InputError(f"{path}: expected a binary little-endian PLY that begins with its vertices")
    properties = words[elements[0] : elements[1] if len(elements) > 1 else None]
    fields = [(line[2], _TYPES.get(line[1], "")) for line in properties if line[0] == "property" and len(line) >= 3]
    names = [name for name, _ in fields]
    missing = [name for column in _COLUMNS for name in column.components if name not in names]
    if missing or len(set(names)) < len(names) or not all(kind for _, kind in fields):
        content = f"without {', '.join(missing)}" if missing else "with properties that no cloud has"
        raise InputError(f"{path}: expected points with normals and colours, found vertices {content}")
    return int(count), np.dtype(fields)
