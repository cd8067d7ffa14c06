"""A whole room's, or a thing's, result folder read back: every station's scan at its place."""

from dataclasses import dataclass
from pathlib import Path

from calib.geometry import Pose
from scanner.io import read_room
from scanner.results.finished_scan import FinishedScan, read_finished_scan
from scanner.results.names import OBJECT_CLOUD_FILE, OBJECT_FILE, ROOM_CLOUD_FILE, ROOM_FILE

_CLOUDS = {ROOM_FILE: ROOM_CLOUD_FILE, OBJECT_FILE: OBJECT_CLOUD_FILE}


@dataclass(frozen=True, eq=False)
class PlacedScan:
    """The scan of a station, called `name`; X_room = rotation X_camera + t. `folder`: its path; `known`: its content if
    it has been read.
    """

    name: str
    folder: Path
    place: Pose
    known: FinishedScan | None = None

    @property
    def scan(self) -> FinishedScan:
        """Read each time: a room's are large together. Raises InputError if a file is missing or damaged."""
        return self.known or read_finished_scan(self.folder)


@dataclass(frozen=True)
class FinishedRoom:
    """All lengths are in `unit`; `cloud`: the file of all stations' cloud; `is_thing`: of a thing, not of a room."""

    unit: str
    stations: tuple[PlacedScan, ...]
    cloud: Path
    is_thing: bool


def read_finished_room(folder: Path) -> FinishedRoom | None:
    """None if the folder holds neither. Raises InputError if its content is malformed."""
    name = next((name for name in _CLOUDS if (folder / name).is_file()), None)
    if name is None:
        return None
    stored = read_room(folder / name)
    return FinishedRoom(
        stored.unit,
        tuple(PlacedScan(each.name, folder / each.folder, each.place) for each in stored.stations),
        folder / _CLOUDS[name],
        name == OBJECT_FILE,
    )
