"""The cloud, unchanged, as binary PLY."""

from scanner.exporting.formats import ExportRequest
from scanner.io import copy_given, new_file, read_cloud
from scanner.quantities import unit_name
from scanner.results import CLOUD_FILE, read_finished_room, read_finished_scan


def export(request: ExportRequest) -> list[str]:
    """Copy the cloud. Raises InputError and OSError."""
    room = read_finished_room(request.result)
    if room is None:
        scan = read_finished_scan(request.result)
        cloud, count, unit = request.result / CLOUD_FILE, len(scan), scan.unit
    else:
        cloud, count, unit = room.cloud, len(read_cloud(room.cloud)), room.unit
    with new_file(request.out, overwrite=request.overwrite) as path:
        copy_given(cloud, path)
    return [f"{count:,} points in {unit_name(unit)}"]
