"""The cloud as binary PLY, unchanged, or as PCD of the Point Cloud Library: the same points, frame and unit."""

from pathlib import Path

import numpy as np

from scanner.exporting.formats import ExportRequest
from scanner.io import CloudPoints, copy_given, new_file, read_cloud
from scanner.quantities import unit_name
from scanner.results import read_finished_result

_PCD_FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "rgb")


def export(request: ExportRequest) -> list[str]:
    """Write the cloud, by the name's ending. Raises InputError and OSError."""
    result = read_finished_result(request.result, request.capture)
    cloud = read_cloud(result.cloud)
    with new_file(request.out, overwrite=request.overwrite) as path:
        if request.out.suffix.lower() == ".pcd":
            write_pcd(path, cloud, result.unit)
        else:
            copy_given(result.cloud, path)
    return [f"{len(cloud):,} points{result.of_how_many} in {unit_name(result.unit)}"]


def write_pcd(path: Path, cloud: CloudPoints, unit: str) -> None:
    """PCD 0.7, binary; a colour is one number, 0x00RRGGBB. Raises OSError."""
    count, fields = len(cloud), len(_PCD_FIELDS)
    rows = np.empty(count, [("floats", "<f4", fields - 1), ("rgb", "<u4")])
    rows["floats"] = np.hstack([cloud.points, cloud.normals])
    red, green, blue = cloud.colours.astype(np.uint32).T
    rows["rgb"] = red << 16 | green << 8 | blue
    header = (
        f"# .PCD v0.7 - unit {' '.join(unit.split())}\nVERSION 0.7\nFIELDS {' '.join(_PCD_FIELDS)}\n"
        f"SIZE{' 4' * fields}\nTYPE{' F' * (fields - 1)} U\nCOUNT{' 1' * fields}\nWIDTH {count}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    )
    path.write_bytes(header.encode("ascii", errors="replace") + rows.tobytes())
