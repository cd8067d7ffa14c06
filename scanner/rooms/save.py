"""The files of a room: a result of every station, and the joint results."""

from pathlib import Path
from typing import Any

import numpy as np

from calib.geometry import Motion
from scanner.configuration import Config
from scanner.exporting.glb import write_pieces
from scanner.io import (
    MATCHES_FILE,
    write_calibration,
    write_matches,
    write_ply,
    write_room,
    write_room_ply,
)
from scanner.quantities import METRES
from scanner.results import (
    CALIBRATION_FILE,
    CAPTURES_FOLDER,
    CLOUD_FILE,
    PLAN_DXF_FILE,
    PLAN_FILE,
    REPORT_FILE,
    ROOM_CLOUD_FILE,
    ROOM_FILE,
    ROOM_MESH_FILE,
    confidence_entries,
    provenance,
)
from scanner.rooms.blended_cloud import blended
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.floorplan import floor_plan
from scanner.rooms.floorplan_dxf import write_dxf
from scanner.rooms.floorplan_svg import plan_svg
from scanner.rooms.mesh import fused
from scanner.rooms.page import write_page
from scanner.rooms.textures import textured
from scanner.rooms.upright import moved_place
from scanner.rooms.verdict import verdict_on
from scanner.ui import Progress


def folder_of_station(room: SolvedRoom, number: int) -> str:
    """Where the result of the group's station `number` is, relative to that of the room: by its capture."""
    return f"{CAPTURES_FOLDER}/{room.group.stations[number] + 1}"


def save_room(room: SolvedRoom, folder: Path, config: Config, progress: Progress) -> None:
    """Write everything. Raises OSError, InputError if Open3D cannot be loaded."""
    with progress.step("Writing the stations"):
        for number, station in enumerate(room.stations):
            place = folder / folder_of_station(room, number)
            place.mkdir(parents=True, exist_ok=True)
            write_matches(place / MATCHES_FILE, station.decoded.matches, None, station.decoded.only_axis)
            write_ply(place / CLOUD_FILE, station.cloud, match=station.cloud.match)
            write_calibration(place / CALIBRATION_FILE, room.calibration)
    verdict, made = verdict_on(room), provenance(folder, config)
    entries = made.entries(room.stations[0].decoded.metadata.identity) | confidence_entries(verdict, room.uncertainty)
    write_calibration(folder / CALIBRATION_FILE, room.calibration, entries)
    write_room(folder / ROOM_FILE, entries_of(room))
    with progress.step("Floor plan"):
        plan = floor_plan(room)
        (folder / PLAN_FILE).write_text(plan_svg(plan, standalone=True), encoding="utf-8")
        write_dxf(folder / PLAN_DXF_FILE, plan)
    with progress.step("Blending the clouds"):
        cloud = blended(room)
        write_room_ply(folder / ROOM_CLOUD_FILE, cloud)
    with progress.step("Meshing"):
        mesh = fused(room)
        if mesh is not None:
            write_pieces(
                folder / ROOM_MESH_FILE, textured(room.stations, room.calibration, mesh), METRES.get(room.unit, 1.0)
            )
    with progress.step("Report"):
        write_page(folder / REPORT_FILE, room, plan, cloud, made)


def entries_of(room: SolvedRoom) -> dict[str, Any]:
    """room.yaml: X_room = rotation X_camera + translation; normal · X_room = offset."""
    entries: dict[str, Any] = {
        "unit": room.unit,
        "stations": [
            {
                "name": station.name,
                "folder": folder_of_station(room, number),
                **_motion(station.place),
                "sigma": {"rotation_deg": station.sigma_deg.tolist(), "translation": station.sigma.tolist()},
                "residual_px": station.residual_px,
            }
            for number, station in enumerate(room.stations)
        ],
        "planes": [_plane(room, number) for number in range(len(room.planes))],
    }
    if room.outlier_stations:
        entries["left_out"] = [
            {"name": each.name, "cause": each.cause, "reason": each.reason} for each in room.outlier_stations
        ]
    if room.group.ambiguous:
        entries["alternatives"] = [
            {
                "behind_nats": each.behind_nats,
                "stations": [_motion(moved_place(place, room.upright, room.factor)) for place in each.places],
            }
            for each in room.group.alternatives
        ]
    return entries


def _motion(place: Motion) -> dict[str, Any]:
    return {"rotation": place.rotation.tolist(), "translation": place.translation.tolist()}


def _plane(room: SolvedRoom, number: int) -> dict[str, Any]:
    plane, columns = room.planes[number], room.estimate.room.plane_columns(number)
    sigma = np.sqrt(np.diag(room.estimate.covariance)[columns])
    entry: dict[str, Any] = {
        "normal": plane.normal.tolist(),
        "offset": plane.offset,
        "seen_from": [room.stations[k].name for k in room.estimate.stations_of[number]],
    }
    if np.isfinite(sigma).all():
        tilt, offset = float(np.degrees(np.hypot(*sigma[:2]))), float(room.factor * sigma[2])
        entry["sigma"] = {"normal_deg": tilt, "offset": offset}
        entry["waves"] = float(room.factor * room.estimate.waves[number])
    return entry
