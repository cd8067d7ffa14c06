"""Point clouds as binary PLY (Turk 1994), the way MeshLab, CloudCompare and Open3D read it."""

from pathlib import Path

import numpy as np

from scanner.cloud import Cloud
from scanner.merged_cloud import MergedCloud

_VERTEX = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")),
        *((name, "u1") for name in ("red", "green", "blue")),
    ]
)
_TYPE_NAMES = {"f": "float", "u": "uchar"}


def write_ply(path: Path, cloud: Cloud) -> None:
    """Write the points that are there, with normals and colours, row by row of the camera's image.

    Raises OSError if the file cannot be written.
    """
    _write(path, cloud, "camera frame: x right, y down, z forward, origin at the camera's centre")


def write_merged_ply(path: Path, cloud: MergedCloud) -> None:
    """The same for a cloud of several captures. Raises OSError if the file cannot be written."""
    _write(path, cloud, "corner frame: origin at the corner's vertex, axes along its edges, z along the most upright")


def _write(path: Path, cloud: Cloud | MergedCloud, frame: str) -> None:
    there = cloud.there
    vertices = np.empty(int(there.sum()), dtype=_VERTEX)
    for names, values in (
        (("x", "y", "z"), cloud.points),
        (("nx", "ny", "nz"), cloud.normals),
        (("red", "green", "blue"), cloud.colours),
    ):
        chosen = values[there]
        for axis, name in enumerate(names):
            vertices[name] = chosen[:, axis]
    with path.open("wb") as file:
        file.write(_header(len(vertices), cloud.unit, frame))
        file.write(vertices.tobytes())


def _header(count: int, unit: str, frame: str) -> bytes:
    # The unit comes from a file that a person wrote: whatever it says, it must not end the comment or the header.
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment unit {' '.join(unit.split())} (of x, y, z)",
        f"comment {frame}",
        f"element vertex {count}",
        *(f"property {_TYPE_NAMES[_VERTEX[name].kind]} {name}" for name in _VERTEX.names or ()),
        "end_header",
    ]
    return "".join(f"{line}\n" for line in lines).encode("ascii", errors="replace")
