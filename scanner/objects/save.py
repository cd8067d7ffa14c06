"""The files of a thing: a result of every station, and the joint results."""

from pathlib import Path
from typing import Any

import numpy as np

from scanner.configuration import Config
from scanner.io import write_room, write_room_ply
from scanner.objects.contents import ObjectSurface, SolvedObject
from scanner.objects.page import write_page
from scanner.objects.surface import cloud_of, surface_of
from scanner.objects.verdict import verdict_on
from scanner.results import (
    OBJECT_CLOUD_FILE,
    OBJECT_FILE,
    OBJECT_MESH_FILE,
    REPORT_FILE,
    Verdict,
    finding_entries,
    pose_error_entries,
    provenance,
)
from scanner.rooms.save import outlier_entries, station_entries, write_stations, write_textured
from scanner.ui import Progress


def save_object(
    solved: SolvedObject, folder: Path, config: Config, progress: Progress, *, fill: bool
) -> tuple[ObjectSurface | None, Verdict]:
    """Write everything; returns the surface, if there is one, and the verdict. Raises OSError, InputError if Open3D
    cannot be loaded.
    """
    made, verdict = provenance(folder, config), verdict_on(solved)
    with progress.step("Writing the stations"):
        write_stations(folder, solved.stations, solved.calibration, verdict, solved.uncertainty, made)
    with progress.step("Blending the clouds"):
        cloud = cloud_of(solved)
        write_room_ply(folder / OBJECT_CLOUD_FILE, cloud)
    with progress.step("Meshing"):
        surface = surface_of(solved, cloud, fill=fill)
        if surface is not None:
            write_textured(folder / OBJECT_MESH_FILE, surface.mesh, solved.stations, solved.calibration)
    write_room(folder / OBJECT_FILE, entries_of(solved, surface))
    with progress.step("Report"):
        write_page(folder / REPORT_FILE, solved, surface, cloud, made)
    return surface, verdict


def entries_of(solved: SolvedObject, surface: ObjectSurface | None) -> dict[str, Any]:
    """object.yaml: X_thing = rotation X_camera + translation."""
    entries: dict[str, Any] = {
        "unit": solved.unit,
        "stations": [station_entries(station) for station in solved.stations],
    }
    entries |= pose_error_entries(solved.pose_errors, solved.calibration.pose.translation)
    if solved.turntable is not None and solved.axis is not None:
        point, direction = solved.axis.tolist()
        angles = np.round(solved.turntable.angles_deg, 4).tolist()
        entries["turntable"] = {"point": point, "direction": direction, "angles_deg": angles}
    if surface is not None:
        entries["closed"] = surface.closed
        entries["area"], entries["area_sigma"] = surface.area
        entries["bridged_share"] = surface.bridged
        if surface.volume is not None:
            entries["volume"], entries["volume_sigma"] = surface.volume
    entries["findings"] = finding_entries(verdict_on(solved).findings)
    return entries | outlier_entries(solved.outlier_stations)
