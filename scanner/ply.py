"""Point clouds as binary PLY (Turk 1994), the way MeshLab, CloudCompare and Open3D read it."""

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Bools
from calib.compiled import compiled
from scanner.merged_cloud import MergedCloud

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
