"""What the results of rooms and of things hold of their stations: a result of each, and entries of the joint file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calib.diagnostics import Uncertainty
from calib.geometry import Calibration, Pose
from scanner.exporting import Mesh, write_pieces
from scanner.io import MATCHES_FILE, write_calibration, write_matches, write_ply
from scanner.quantities import METRES
from scanner.results import CALIBRATION_FILE, CAPTURES_FOLDER, CLOUD_FILE, Provenance, Verdict, confidence_entries
from scanner.rooms.contents import OutlierStation, Station
from scanner.rooms.textures import textured


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
