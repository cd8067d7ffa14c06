"""`cloud.ply` read back: the points of a result, in the order in which they were written."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Floats
from scanner.errors import InputError

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
