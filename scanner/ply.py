"""Point clouds as binary PLY (Turk 1994), the way MeshLab, CloudCompare and Open3D read it."""

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Bools
from scanner.merged_cloud import MergedCloud

_VERTEX = np.dtype([("point", "<f4", 3), ("normal", "<f4", 3), ("colour", "u1", 3)])
_PROPERTIES = (
    *(f"float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
    *(f"uchar {name}" for name in ("red", "green", "blue")),
)
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
    there = np.flatnonzero(cloud.there)
    vertices = np.empty(len(there), dtype=_VERTEX)
    for name, values in (("point", cloud.points), ("normal", cloud.normals), ("colour", cloud.colours)):
        vertices[name] = values.reshape(-1, 3).take(there, axis=0)
    with path.open("wb") as file:
        file.write(_header(len(vertices), cloud.unit, frame))
        file.write(vertices.data)


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
