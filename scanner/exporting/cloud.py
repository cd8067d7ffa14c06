"""The cloud, unchanged, as binary PLY."""

from scanner.exporting.formats import ExportRequest
from scanner.io import copy_given, new_file, read_cloud
from scanner.quantities import unit_name
from scanner.results import read_finished_result


def export(request: ExportRequest) -> list[str]:
    """Copy the cloud. Raises InputError and OSError."""
    result = read_finished_result(request.result, request.capture)
    count = len(read_cloud(result.cloud))
    with new_file(request.out, overwrite=request.overwrite) as path:
        copy_given(result.cloud, path)
    return [f"{count:,} points{result.of_how_many} in {unit_name(result.unit)}"]
