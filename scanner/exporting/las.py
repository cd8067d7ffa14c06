"""The cloud as LAS 1.4 or, compressed, LAZ, with laspy, an optional dependency: in metres, z up, with 16-bit colours.

The camera's axes become x right, y forward, z up; a room's, an object's, a corner's and those of steps stay.
Coordinates are whole numbers of micrometres, or more in larger scenes (ASPRS LAS 1.4 R15, point format 7).
"""

from pathlib import Path

import numpy as np

from calib.numerics import Floats
from hw.optional_parts import LAS
from scanner.cleaning import CleanedCloud, read_cleaned
from scanner.errors import InputError
from scanner.exporting.formats import ExportRequest
from scanner.exporting.units import in_metres, noted
from scanner.io import new_file

_Z_UP_FROM_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_FINEST_M, _MOST_STEPS = 1e-6, 1e9  # of a coordinate, which has 32 bits


def export(request: ExportRequest) -> list[str]:
    """Write the cloud, compressed if the name ends in .laz. Raises InputError and OSError."""
    refuse_without_laspy()
    result = read_cleaned(request.result, request.capture)
    cloud = result.cloud()
    metres, findings = in_metres(result.unit)
    points = metres * (cloud.points if result.has_upright_cloud else cloud.points @ _Z_UP_FROM_CAMERA.T)
    with new_file(request.out, overwrite=request.overwrite) as path:
        write_las(path, points, cloud, compressed=request.out.suffix.lower() == ".laz")
    return [f"{len(cloud):,} points{result.of_how_many} in metres, z up", *noted(findings)]


def refuse_without_laspy() -> None:
    """Raise InputError that names the extra if laspy, or what compresses, cannot be imported."""
    with LAS.needed("LAS", "laspy", InputError):
        import laspy  # noqa: F401
        import lazrs  # noqa: F401


def write_las(path: Path, points: Floats, cloud: CleanedCloud, *, compressed: bool) -> None:
    """Points (N, 3) in metres, with the colours of the cloud. Raises OSError."""
    import laspy

    header = laspy.LasHeader(point_format=7, version="1.4")
    low = points.min(axis=0)
    extent = float(np.max(points.max(axis=0) - low))
    step = max(_FINEST_M, 10.0 ** np.ceil(np.log10(max(extent, _FINEST_M) / _MOST_STEPS)))
    header.scales = np.full(3, step)
    header.offsets = np.floor(low)
    header.generating_software = "roomscan"
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.red, las.green, las.blue = (np.uint16(257) * cloud.colours.astype(np.uint16)).T
    las.return_number[:] = las.number_of_returns[:] = 1
    with path.open("wb") as file:
        las.write(file, do_compress=compressed)
