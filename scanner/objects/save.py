"""The files of a thing: a result of every station, and the joint results."""

from pathlib import Path
from typing import Any

import numpy as np

from scanner.configuration import Config
from scanner.exporting.glb import write_pieces
from scanner.io import MATCHES_FILE, write_calibration, write_matches, write_ply, write_room, write_room_ply
from scanner.objects.contents import SolvedObject, Surface
from scanner.objects.page import write_page
from scanner.objects.surface import cloud_of, surface_of
from scanner.objects.verdict import verdict_on
from scanner.quantities import METRES
from scanner.results import (
    CALIBRATION_FILE,
    CAPTURES_FOLDER,
    CLOUD_FILE,
    OBJECT_CLOUD_FILE,
    OBJECT_FILE,
    OBJECT_MESH_FILE,
    REPORT_FILE,
    confidence_entries,
    provenance,
)
from scanner.rooms.textures import textured
from scanner.ui import Progress


def save_object(
    solved: SolvedObject, folder: Path, config: Config, progress: Progress, *, fill: bool
) -> Surface | None:
    """Write everything. Raises OSError, InputError if Open3D cannot be loaded."""
    with progress.step("Writing the stations"):
        for number, station in zip(solved.numbers, solved.stations, strict=True):
            place = folder / _folder_of(number)
            place.mkdir(parents=True, exist_ok=True)
            write_matches(place / MATCHES_FILE, station.decoded.matches, None, station.decoded.only_axis)
            write_ply(place / CLOUD_FILE, station.cloud, match=station.cloud.match)
            write_calibration(place / CALIBRATION_FILE, solved.calibration)
    verdict, made = verdict_on(solved), provenance(folder, config)
    entries = made.entries(solved.stations[0].decoded.metadata.identity) | confidence_entries(verdict, None)
    write_calibration(folder / CALIBRATION_FILE, solved.calibration, entries)
    with progress.step("Blending the clouds"):
        cloud = cloud_of(solved)
        write_room_ply(folder / OBJECT_CLOUD_FILE, cloud)
    with progress.step("Meshing"):
        surface = surface_of(solved, cloud, fill=fill)
        if surface is not None:
            pieces = textured(solved.stations, solved.calibration, surface.mesh)
            write_pieces(folder / OBJECT_MESH_FILE, pieces, METRES.get(solved.unit, 1.0))
    write_room(folder / OBJECT_FILE, entries_of(solved, surface))
    with progress.step("Report"):
        write_page(folder / REPORT_FILE, solved, surface, cloud, made)
    return surface


def _folder_of(number: int) -> str:
    return f"{CAPTURES_FOLDER}/{number + 1}"


def entries_of(solved: SolvedObject, surface: Surface | None) -> dict[str, Any]:
    """object.yaml: X_thing = rotation X_camera + translation."""
    entries: dict[str, Any] = {
        "unit": solved.unit,
        "stations": [
            {
                "name": station.name,
                "folder": _folder_of(number),
                "rotation": station.place.rotation.tolist(),
                "translation": station.place.translation.tolist(),
                "sigma": {"rotation_deg": station.sigma_deg.tolist(), "translation": station.sigma.tolist()},
            }
            for number, station in zip(solved.numbers, solved.stations, strict=True)
        ],
    }
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
    if solved.outlier_stations:
        entries["left_out"] = [
            {"name": each.name, "cause": each.cause, "reason": each.reason} for each in solved.outlier_stations
        ]
    return entries
