"""The cloud as ASTM E57, by way of pye57, which is an optional dependency.

E57 is in metres, and the programs that read it take z for up. So the camera's axes (x right, y down, z forward) become
x right, y forward, z up, with the origin at the camera's centre: upright if the camera was.
"""

from pathlib import Path

import numpy as np

from calib.numerics import Floats
from scanner.errors import InputError
from scanner.results import FinishedScan

_Z_UP_FROM_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def refuse_without_pye57() -> None:
    """Raise InputError that names the extra if pye57 cannot be imported."""
    try:
        import pye57  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"E57 needs the package pye57 ({error}): install roomscan with its extra 'e57', as in "
            "pip install --editable '.[e57]'"
        ) from error


def write_e57(path: Path, scan: FinishedScan, metres_per_unit: float) -> None:
    """Write one scan with coordinates, colours, and the camera's row and column of every point.

    Raises InputError if pye57 is not installed, OSError if the file cannot be written.
    """
    refuse_without_pye57()
    import pye57

    path.touch()  # pye57 has exceptions of its own for a place that cannot be written to
    points: Floats = metres_per_unit * scan.points @ _Z_UP_FROM_CAMERA.T
    data = {f"cartesian{axis}": np.ascontiguousarray(points[:, i]) for i, axis in enumerate("XYZ")}
    for channel, name in enumerate(("Red", "Green", "Blue")):
        data[f"color{name}"] = np.ascontiguousarray(scan.colours[:, channel])
    data |= {
        "columnIndex": scan.pixel[:, 0].astype(np.int32),
        "rowIndex": scan.pixel[:, 1].astype(np.int32),
        "cartesianInvalidState": np.zeros(len(points), np.uint8),  # 0: valid. Readers like pye57's insist on it
    }
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw(data, name="roomscan")
