"""Point clouds as binary PLY (Turk 1994), the way MeshLab, CloudCompare and Open3D read it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, compiled
from calib.pointcloud import MergedCloud
from scanner.errors import InputError

_FLOATS, _BYTES = ("x", "y", "z", "nx", "ny", "nz"), ("red", "green", "blue")
_VERTEX = np.dtype([*((name, "<f4") for name in _FLOATS), *((name, "u1") for name in _BYTES)])
_PROPERTIES = (*(f"float {name}" for name in _FLOATS), *(f"uchar {name}" for name in _BYTES))
_PIECE = 1 << 15  # points to be written at once, from the processor's cache
_CAMERA_FRAME = "camera frame: x right, y down, z forward, origin at the camera's centre"


class PointCloud(Protocol):
    """What is written: `points`, `normals` and RGB `colours` (..., 3), where they are `there` (...)."""

    @property
    def points(self) -> NDArray[np.float32]: ...  # noqa: D102
    @property
    def normals(self) -> NDArray[np.float32]: ...  # noqa: D102
    @property
    def colours(self) -> NDArray[np.uint8]: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def there(self) -> Bools: ...  # noqa: D102


def write_ply(path: Path, cloud: PointCloud) -> None:
    """Write the points that are there, in the camera's frame, with normals and colours, row by row of its image.

    Raises OSError if the file cannot be written.
    """
    _write(path, cloud, _CAMERA_FRAME)


def write_merged_ply(path: Path, cloud: MergedCloud) -> None:
    """The same for a cloud of several captures. Raises OSError if the file cannot be written."""
    _write(path, cloud, "corner frame: origin at the corner's vertex, axes along its edges, z along the most upright")


def _write(path: Path, cloud: PointCloud, frame: str) -> None:
    there = cloud.there.ravel()
    points, normals, colours = cloud.points.reshape(-1, 3), cloud.normals.reshape(-1, 3), cloud.colours.reshape(-1, 3)
    vertices = np.empty(_PIECE, dtype=_VERTEX)
    with path.open("wb") as file:
        file.write(_header(int(np.count_nonzero(there)), cloud.unit, frame))
        for start in range(0, len(there), _PIECE):
            some = slice(start, start + _PIECE)
            count = _fill(vertices, there[some], points[some], normals[some], colours[some])
            file.write(vertices[:count].data)


@compiled
def _fill(
    vertices: NDArray[np.void],
    there: Bools,
    points: NDArray[np.float32],
    normals: NDArray[np.float32],
    colours: NDArray[np.uint8],
) -> int:
    """Fill in the first vertices with those of N points that are there; returns how many they are."""
    count = 0
    for i in range(len(there)):
        if there[i]:
            vertex = vertices[count]
            vertex.x, vertex.y, vertex.z = points[i, 0], points[i, 1], points[i, 2]
            vertex.nx, vertex.ny, vertex.nz = normals[i, 0], normals[i, 1], normals[i, 2]
            vertex.red, vertex.green, vertex.blue = colours[i, 0], colours[i, 1], colours[i, 2]
            count += 1
    return count


def _header(count: int, unit: str, frame: str) -> bytes:
    # The unit comes from a file that a person wrote: whatever it says, it must not end the comment or the header.
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment unit {' '.join(unit.split())} (of x, y, z)",
        f"comment {frame}",
        f"element vertex {count}",
        *(f"property {name}" for name in _PROPERTIES),
        "end_header",
    ]
    return "".join(f"{line}\n" for line in lines).encode("ascii", errors="replace")


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
_LONGEST_HEADER = 1 << 16
_END = b"end_header\n"


@dataclass(frozen=True)
class CloudPoints:
    """`points` (N, 3), `normals` (N, 3) of unit length, `colours` (N, 3) RGB."""

    points: Floats
    normals: Floats
    colours: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)


def read_cloud(path: Path) -> CloudPoints:
    """Read a binary little-endian PLY that begins with its vertices, as `write_ply` makes it.

    Raises InputError if the file is missing, truncated, or lacks coordinates, normals or colours.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    end = data.find(_END, 0, _LONGEST_HEADER)
    if not data.startswith(b"ply\n") or end < 0:
        raise InputError(f"{path}: expected a PLY file as 'scan' writes it, found something else")
    count, layout = _vertex_layout(path, data[:end].decode("ascii", errors="replace").splitlines())
    start = end + len(_END)
    if len(data) - start < count * layout.itemsize:
        raise InputError(f"{path}: truncated: the header promises {count} points; copy the file again")
    vertices = np.frombuffer(data, layout, count, start)
    return CloudPoints(
        _columns(vertices, ("x", "y", "z")).astype(np.float64),
        _columns(vertices, ("nx", "ny", "nz")).astype(np.float64),
        _columns(vertices, ("red", "green", "blue")).astype(np.uint8),
    )


def _vertex_layout(path: Path, header: list[str]) -> tuple[int, np.dtype[np.void]]:
    """How many vertices there are, and the type of one."""
    words = [line.split() for line in header if line.split()]
    elements = [index for index, line in enumerate(words) if line[0] == "element" and len(line) == 3]
    count = words[elements[0]][2] if elements and words[elements[0]][1] == "vertex" else ""
    if ["format", "binary_little_endian", "1.0"] not in words or not count.isdecimal():
        raise InputError(f"{path}: expected a binary little-endian PLY that begins with its vertices")
    properties = words[elements[0] : elements[1] if len(elements) > 1 else None]
    fields = [(line[2], _TYPES.get(line[1], "")) for line in properties if line[0] == "property" and len(line) >= 3]
    names = [name for name, _ in fields]
    missing = [name for name in ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue") if name not in names]
    if missing or len(set(names)) < len(names) or not all(kind for _, kind in fields):
        found = f"without {', '.join(missing)}" if missing else "with properties that no cloud has"
        raise InputError(f"{path}: expected points with normals and colours, found vertices {found}")
    return int(count), np.dtype(fields)


def _columns(vertices: NDArray[np.void], names: tuple[str, ...]) -> NDArray[np.generic]:
    return np.stack([vertices[name] for name in names], axis=1)
