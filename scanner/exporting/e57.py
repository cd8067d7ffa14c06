"""Write the cloud as ASTM E57, with pye57, an optional dependency.

E57 is in metres, and the programs that read it take z for up. So the camera's axes (x right, y down, z forward) become
x right, y forward, z up, with the origin at the (newest) camera's centre: upright if the camera was. Several captures
are a scan each, with its pose; those of a whole room are in the room's frame.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.geometry import IDENTITY, Pose
from calib.numerics import Floats
from hw.optional_parts import E57
from scanner.cleaning import read_cleaned
from scanner.errors import InputError
from scanner.exporting.formats import ExportRequest
from scanner.exporting.units import in_metres, noted
from scanner.io import new_file
from scanner.results import FinishedScan, PlacedScan

_Z_UP_FROM_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def export(request: ExportRequest) -> list[str]:
    """Write the cloud. Raises InputError and OSError."""
    refuse_without_pye57()
    result = read_cleaned(request.result, request.capture)
    upright = IDENTITY if result.is_upright else Pose(_Z_UP_FROM_CAMERA, np.zeros(3))
    metres, findings = in_metres(result.unit)
    with new_file(request.out, overwrite=request.overwrite) as path:
        scans = [replace(scan, place=upright @ scan.place) for scan in result.stations_before_camera]
        points = write_e57(path, scans, metres)
    of_scans = f"{result.of_how_many}, each a scan of its own," if len(scans) > 1 else ""
    return [f"{points:,} points{of_scans} in metres", *noted(findings)]


def refuse_without_pye57() -> None:
    """Raise InputError that names the extra if pye57 cannot be imported."""
    with E57.needed("E57", "pye57", InputError):
        import pye57  # noqa: F401


def write_e57(path: Path, placed: Sequence[PlacedScan], metres_per_unit: float) -> int:
    """Write scans, each with its pose, coordinates, colours, and the camera's row and column of every point.

    Returns how many points it were. Raises InputError if pye57 is not installed or a scan cannot be read, OSError if
    the file cannot be written.
    """
    refuse_without_pye57()
    import pye57

    path.touch()  # pye57 raises its own exceptions for an unwritable path
    points = 0
    with pye57.E57(str(path), mode="w") as file:
        for station in placed:
            scan = station.scan
            x, y, z, w = Rotation.from_matrix(station.place.rotation @ _Z_UP_FROM_CAMERA.T).as_quat(canonical=True)
            file.write_scan_raw(
                _columns(scan, metres_per_unit),
                name=station.name,
                rotation=np.array([w, x, y, z]),
                translation=metres_per_unit * station.place.translation,
            )
            points += len(scan)
    return points


def _columns(scan: FinishedScan, metres_per_unit: float) -> dict[str, NDArray[np.generic]]:
    """Return the columns in the axes of an upright scanner at the camera's position."""
    points: Floats = metres_per_unit * scan.points @ _Z_UP_FROM_CAMERA.T
    data: dict[str, NDArray[np.generic]] = {
        f"cartesian{axis}": np.ascontiguousarray(points[:, i]) for i, axis in enumerate("XYZ")
    }
    for channel, name in enumerate(("Red", "Green", "Blue")):
        data[f"color{name}"] = np.ascontiguousarray(scan.colours[:, channel])
    data |= {
        "columnIndex": scan.pixel[:, 0].astype(np.int32),
        "rowIndex": scan.pixel[:, 1].astype(np.int32),
        "cartesianInvalidState": np.zeros(len(points), np.uint8),  # 0: valid; readers such as pye57 require it
    }
    return data
