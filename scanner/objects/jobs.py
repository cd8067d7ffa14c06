"""The jobs of things: from stations that exist, and live."""

from collections.abc import Sequence
from pathlib import Path

from calib.refusal import NoMeasurementError
from scanner.configuration import Config
from scanner.exporting import open3d
from scanner.objects.contents import ObjectSurface, SolvedObject
from scanner.objects.object_rig import rig_from_object
from scanner.objects.save import save_object
from scanner.objects.solve import solve_object
from scanner.objects.verdict import verdict_on
from scanner.results import new_result
from scanner.rooms import (
    check_stations,
    given_rig,
    read_stations,
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
        start = known or rig_from_object(captures, config, terminal)
        solved = solve_object(captures, start, config, terminal)
        surface = save_object(solved, folder, config, terminal, fill=fill)
        verdict = verdict_on(solved)
        if verdict.grade == "refused":
            finding, reason = verdict.findings[0], " ".join([verdict.headline, *verdict.reasons[:1]])
            raise NoMeasurementError(finding.kind, reason, finding.advice, finding.data)
    return solved, surface
