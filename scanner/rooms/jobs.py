"""The job of a room: from stations that exist, or live."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from scanner.configuration import Config
from scanner.exporting import open3d
from scanner.results import Decoded, Job
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.live import take_room
from scanner.rooms.save import save_room
from scanner.rooms.scene_rig import rig_from_stations
from scanner.rooms.solve import solve_room
from scanner.stations import RigStart, check_stations, given_rig, read_stations
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

    def acquire(folder: Path) -> tuple[list[Decoded], RigStart]:
        if isinstance(stations, int):
            return take_room(config, stations, folder, terminal)
        captures = read_stations(stations, config, terminal, known.given if known else None)
        return captures, known or rig_from_stations(captures, config, terminal)

    def solve(acquired: tuple[list[Decoded], RigStart]) -> SolvedRoom:
        captures, start = acquired
        if any(capture.only_axis for capture in captures):
            start = replace(start, uncertainty=None)  # one axis fits the epipolar lines of any rig
        return solve_room(captures, start, config, terminal)

    job = Job(acquire, solve, lambda room, folder: save_room(room, folder, config, terminal))
    return job.run(config, out, is_live=isinstance(stations, int), overwrite=overwrite, terminal=terminal)
