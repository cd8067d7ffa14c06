"""The cloud as it is in the result: binary PLY."""

from scanner.exporting.formats import Request
from scanner.io import copy_given, new_file
from scanner.quantities import unit_name
from scanner.results import CLOUD_FILE, read_finished_scan


def export(request: Request) -> list[str]:
    """Copy the cloud. Raises InputError and OSError."""
    scan = read_finished_scan(request.result)
    with new_file(request.out, overwrite=request.overwrite) as path:
        copy_given(request.result / CLOUD_FILE, path)
    return [f"{len(scan):,} points in {unit_name(scan.unit)}"]
