"""The cloud, unchanged, as binary PLY."""

from scanner.exporting.formats import Request
from scanner.io import copy_given, new_file, read_cloud, read_room
from scanner.quantities import unit_name
from scanner.results import (
    CLOUD_FILE,
    OBJECT_CLOUD_FILE,
    OBJECT_FILE,
    ROOM_CLOUD_FILE,
    ROOM_FILE,
    read_finished_scan,
)


def export(request: Request) -> list[str]:
    """Copy the cloud. Raises InputError and OSError."""
    for listing, cloud in ((ROOM_FILE, ROOM_CLOUD_FILE), (OBJECT_FILE, OBJECT_CLOUD_FILE)):
        if (request.result / listing).is_file():
            return _of_all_stations(request, listing, cloud)
    scan = read_finished_scan(request.result)
    with new_file(request.out, overwrite=request.overwrite) as path:
        copy_given(request.result / CLOUD_FILE, path)
    return [f"{len(scan):,} points in {unit_name(scan.unit)}"]


def _of_all_stations(request: Request, listing: str, name: str) -> list[str]:
    cloud, unit = read_cloud(request.result / name), read_room(request.result / listing).unit
    with new_file(request.out, overwrite=request.overwrite) as path:
        copy_given(request.result / name, path)
    return [f"{len(cloud):,} points in {unit_name(unit)}"]
