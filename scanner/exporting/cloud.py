"""The cloud as binary PLY, unchanged if there are no steps, or as PCD of the Point Cloud Library."""

from pathlib import Path

import numpy as np

from scanner.cleaning import CleanedCloud, read_cleaned
from scanner.exporting.formats import ExportRequest
from scanner.io import copy_given, new_file, write_room_ply
from scanner.quantities import unit_name

_PCD_FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "rgb")


def export(request: ExportRequest) -> list[str]:
    """Write the cloud, by the name's ending. Raises InputError and OSError."""
    result = read_cleaned(request.result, request.capture)
    cloud = result.cloud()
    with new_file(request.out, overwrite=request.overwrite) as path:
        if request.out.suffix.lower() == ".pcd":
            write_pcd(path, cloud, result.unit)
        elif result.steps:
            write_room_ply(path, cloud, cloud.frame, match=cloud.match)
        else:
            copy_given(result.whole.cloud, path)
    return [f"{len(cloud):,} points{result.of_how_many} in {unit_name(result.unit)}"]


def write_pcd(path: Path, cloud: CleanedCloud, unit: str) -> None:
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
