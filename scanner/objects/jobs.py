"""The jobs of things: from stations that exist, and live."""

from collections.abc import Sequence
from pathlib import Path

from calib.geometry import Pose
from calib.refusal import NoMeasurementError
from scanner.configuration import Config
from scanner.exporting import open3d
from scanner.objects.contents import ObjectSurface, SolvedObject
from scanner.objects.save import save_object
from scanner.objects.solve import solve_object
from scanner.objects.verdict import verdict_on
from scanner.results import Decoded, new_result
from scanner.rooms import (
    check_stations,
    given_rig,
    read_stations,
    rig_from_placed,
    rig_from_scene,
    take_object_stations,
    writing_refusals,
)
from scanner.ui import SILENT, Terminal


def scan_object(
    config: Config,
    out: Path,
    *,
    calibration: Path | None = None,
    stations: Sequence[Path] | int,
    fill: bool = False,
    overwrite: bool = False,
    terminal: Terminal = SILENT,
) -> tuple[SolvedObject, ObjectSurface | None]:
    """Join `stations` of a thing, in any order; or capture that many, between which it is turned. Without a
    `calibration` of the rig, the points that the stations' pictures share calibrate it.

    Raises InputError, DeviceError, RefusalError.
    """
    open3d()  # fail early if it is missing
    known = given_rig(calibration, config) if calibration else None
    config.principal_point(config.camera_size)
    if isinstance(stations, int):
        check_stations(config, stations, terminal)
    made = new_result(out, config, overwrite=overwrite, keep_capture=isinstance(stations, int), tell=terminal.note)
    with made as folder, writing_refusals(folder, config):
        if isinstance(stations, int):
            captures = take_object_stations(config, stations, folder, terminal)
        else:
            captures = read_stations(stations, config, terminal, known.given if known else None)
        solved = (
            solve_object(captures, known, config, terminal) if known else _solve_with_rig(captures, config, terminal)
        )
        surface = save_object(solved, folder, config, terminal, fill=fill)
        verdict = verdict_on(solved)
        if verdict.grade == "refused":
            finding, reason = verdict.findings[0], " ".join([verdict.headline, *verdict.reasons[:1]])
            raise NoMeasurementError(finding.kind, reason, finding.advice, finding.data)
    return solved, surface


def _solve_with_rig(captures: Sequence[Decoded], config: Config, terminal: Terminal) -> SolvedObject:
    """The object and the rig: stations whose pictures have points in common calibrate it well enough to place all by
    their surfaces, which calibrate it for good. Raises RefusalError.
    """
    rough = rig_from_scene(captures, config, terminal, provisional=True)
    placed = solve_object(captures, rough, config, terminal)
    unit = placed.calibration.baseline
    stations = [
        (station.decoded, Pose(back.rotation, back.translation / unit))
        for station in placed.stations
        for back in (station.place.inverse(),)
    ]
    start = rig_from_placed(rough, stations, config, terminal)
    return solve_object(captures, start, config, terminal)
