"""The job of a thing: from stations that exist, or live."""

from collections.abc import Sequence
from pathlib import Path

from calib.refusal import NoMeasurementError
from scanner.configuration import Config
from scanner.exporting import open3d
from scanner.objects.contents import ObjectSurface, SolvedObject
from scanner.objects.object_rig import rig_from_object
from scanner.objects.save import save_object
from scanner.objects.solve import solve_object
from scanner.results import Decoded, Job, Verdict
from scanner.rooms import guide_without_corner
from scanner.stations import check_stations, given_rig, read_stations, take_stations
from scanner.ui import SILENT, Terminal

_TURN = "Turn the thing, or put it down another way; leave the rig as it is"


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
    surface: ObjectSurface | None = None

    def acquire(folder: Path) -> list[Decoded]:
        if isinstance(stations, int):
            return _taken(config, stations, folder, terminal, calibrates=known is None)
        return read_stations(stations, config, terminal, known.given if known else None)

    def solve(captures: Sequence[Decoded]) -> SolvedObject:
        return solve_object(captures, known or rig_from_object(captures, config, terminal), config, terminal)

    def write(solved: SolvedObject, folder: Path) -> Verdict:
        nonlocal surface
        surface, verdict = save_object(solved, folder, config, terminal, fill=fill)
        return verdict

    job = Job(acquire, solve, write, _refusal_of)
    solved = job.run(config, out, is_live=isinstance(stations, int), overwrite=overwrite, terminal=terminal)
    return solved, surface


def _taken(config: Config, number: int, folder: Path, terminal: Terminal, *, calibrates: bool) -> list[Decoded]:
    """Stations of a thing before a resting rig. Where they calibrate it, the operator is told between them which next
    one would help most.
    """
    captures: list[Decoded] = []
    for capture in take_stations(config, number, folder, terminal, _TURN):
        captures.append(capture)
        if calibrates and len(captures) < number:
            terminal.show(guide_without_corner(captures, config, terminal, "object"))
    return captures


def _refusal_of(verdict: Verdict) -> NoMeasurementError:
    finding, reason = verdict.findings[0], " ".join([verdict.headline, *verdict.reasons[:1]])
    return NoMeasurementError(finding.kind, reason, finding.advice, finding.data)
