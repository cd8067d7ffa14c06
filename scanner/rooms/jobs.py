"""The jobs of rooms: from stations that exist, and live."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.exporting import open3d
from scanner.results import REFUSAL_FILE, Verdict, new_result, provenance, verdict_entries, write_refusal
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.document import given_rig, read_stations
from scanner.rooms.live import check_stations, take_stations
from scanner.rooms.save import save_room
from scanner.rooms.scene_rig import rig_from_stations
from scanner.rooms.solve import solve_room
from scanner.rooms.verdict import verdict_on
from scanner.ui import SILENT, Terminal


def scan_room(
    config: Config,
    out: Path,
    *,
    stations: Sequence[Path] | int,
    calibration: Path | None = None,
    overwrite: bool = False,
    terminal: Terminal = SILENT,
) -> SolvedRoom:
    """Join `stations` of one unchanged rig, in any order; or capture that many, between which it is moved as a
    whole. Without a `calibration`, corners that `stations` show calibrate the rig, or what their pictures share.

    Raises InputError, DeviceError, RefusalError.
    """
    config.principal_point(config.camera_size)
    open3d()  # fail early if it is missing
    known = given_rig(calibration, config) if calibration else None
    if isinstance(stations, int):
        check_stations(config, stations, terminal)
    made = new_result(out, config, overwrite=overwrite, keep_capture=isinstance(stations, int), tell=terminal.note)
    with made as folder, writing_refusals(folder, config):
        if isinstance(stations, int):
            captures, start = take_stations(config, stations, folder, terminal)
        else:
            captures = read_stations(stations, config, terminal, known.given if known else None)
            start = known or rig_from_stations(captures, config, terminal)
        if any(capture.only_axis for capture in captures):
            start = replace(start, uncertainty=None)  # one axis fits the epipolar lines of any rig
        solved = solve_room(captures, start, config, terminal)
        save_room(solved, folder, config, terminal)
        verdict = verdict_on(solved)
        if verdict.grade == "refused":
            raise RefusalError.of(verdict.findings[0])
    return solved


@contextmanager
def writing_refusals(folder: Path, config: Config) -> Iterator[None]:
    """After a RefusalError in the block the folder says why, for programs."""
    try:
        yield
    except RefusalError as refusal:
        finding = refusal.finding
        verdict = Verdict("refused", finding.message, (), finding.advice, (finding,), (finding.kind,))
        write_refusal(folder / REFUSAL_FILE, provenance(folder, config).entries({}) | verdict_entries(verdict))
        raise
