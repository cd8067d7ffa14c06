"""The files of a room: a result of every station, and the joint results.

What the results of rooms and of things hold of their stations: a result of each, and entries of the joint file.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.diagnostics import PoseErrors, Uncertainty
from calib.geometry import Calibration, Pose
from scanner.configuration import Config
from scanner.exporting import Mesh, write_pieces
from scanner.io import MATCHES_FILE, write_calibration, write_matches, write_ply, write_room, write_room_ply
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
    Provenance,
    Verdict,
    confidence_entries,
    finding_entries,
    pose_error_entries,
    provenance,
)
from scanner.rooms.contents import OutlierStation, SolvedRoom, Station
from scanner.rooms.floorplan import floor_plan, plan_svg, write_dxf
from scanner.rooms.mesh import blended, fused
from scanner.rooms.page import write_page
from scanner.rooms.textures import textured
from scanner.rooms.verdict import verdict_on
from scanner.ui import Progress


def write_stations(
    folder: Path,
    stations: Sequence[Station],
    calibration: Calibration,
    verdict: Verdict,
    uncertainty: Uncertainty | None,
    made: Provenance,
) -> None:
    """Write a result of every station, and the calibration of all with its verdict. Raises OSError."""
    for station in stations:
        place = folder / _folder_of(station)
        place.mkdir(parents=True, exist_ok=True)
        write_matches(place / MATCHES_FILE, station.decoded.matches, None, station.decoded.only_axis)
        write_ply(place / CLOUD_FILE, station.cloud, match=station.cloud.match)
        write_calibration(place / CALIBRATION_FILE, calibration)
    entries = made.entries(stations[0].decoded.metadata.identity) | confidence_entries(verdict, uncertainty)
    write_calibration(folder / CALIBRATION_FILE, calibration, entries)


def write_textured(path: Path, mesh: Mesh, stations: Sequence[Station], calibration: Calibration) -> None:
    """Write a mesh under the stations' pictures as a .glb. Raises OSError."""
    write_pieces(path, textured(stations, calibration, mesh), METRES.get(calibration.unit, 1.0))


def station_entries(station: Station) -> dict[str, Any]:
    """The entry of a station: X_room = rotation X_camera + translation."""
    return {
        "name": station.name,
        "folder": _folder_of(station),
        **motion_entries(station.place),
        "sigma": {"rotation_deg": station.sigma_deg.tolist(), "translation": station.sigma.tolist()},
    }


def motion_entries(place: Pose) -> dict[str, Any]:
    """The entries of a pose."""
    return {"rotation": place.rotation.tolist(), "translation": place.translation.tolist()}


def outlier_entries(outliers: Sequence[OutlierStation]) -> dict[str, Any]:
    """A key for the captures that are left out; nothing without any."""
    entries = [
        {"name": outlier.name, "cause": outlier.finding.kind.name.replace("-", " "), "reason": outlier.finding.message}
        for outlier in outliers
    ]
    return {"left_out": entries} if entries else {}


def _folder_of(station: Station) -> str:
    """Where its result is, relative to the joint one."""
    return f"{CAPTURES_FOLDER}/{station.number + 1}"


def save_room(room: SolvedRoom, folder: Path, config: Config, progress: Progress) -> Verdict:
    """Write everything, with the verdict, which is returned. Raises OSError, InputError if Open3D cannot be loaded."""
    made, verdict = provenance(folder, config), verdict_on(room)
    with progress.step("Writing the stations"):
        write_stations(folder, room.stations, room.calibration, verdict, room.uncertainty, made)
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
            write_textured(folder / ROOM_MESH_FILE, mesh, room.stations, room.calibration)
    with progress.step("Report"):
        write_page(folder / REPORT_FILE, room, plan, cloud, made)
    return verdict


def entries_of(room: SolvedRoom) -> dict[str, Any]:
    """room.yaml: X_room = rotation X_camera + translation; normal · X_room = offset."""
    entries: dict[str, Any] = {
        "unit": room.unit,
        "stations": [station_entries(station) | {"residual_px": station.residual_px} for station in room.stations],
        "planes": [_plane(room, number) for number in range(len(room.planes))],
    }
    entries |= pose_error_entries(pose_errors(room), room.calibration.pose.translation)
    entries |= outlier_entries(room.outlier_stations)
    entries["findings"] = finding_entries(verdict_on(room).findings)
    if room.group.ambiguous:
        entries["alternatives"] = [
            {
                "behind_nats": alternative.behind_nats,
                "stations": [
                    motion_entries((room.upright @ place).scaled(room.factor)) for place in alternative.places
                ],
            }
            for alternative in room.group.alternatives
        ]
    return entries


def pose_errors(room: SolvedRoom) -> PoseErrors:
    """Of the stations' poses, in the room's frame and unit."""
    estimate = room.estimate.room
    columns = slice(0, estimate.place_columns(len(estimate.places) - 1).stop)
    to_room = room.upright.scaled(room.factor).adjoint @ np.diag([1.0] * 3 + [room.factor] * 3)
    about_origin = [Pose(np.eye(3), place.translation).adjoint for place in estimate.places]
    return PoseErrors.from_joint(
        room.estimate.covariance[columns, columns], [to_room @ motion for motion in about_origin]
    )


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
