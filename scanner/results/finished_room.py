"""A whole room's, or a thing's, result folder read back: every station's scan at its place."""

from dataclasses import dataclass
from pathlib import Path

from calib.geometry import Motion
from scanner.io import read_room
from scanner.results.finished_scan import FinishedScan, read_finished_scan
from scanner.results.names import OBJECT_FILE, ROOM_FILE


@dataclass(frozen=True, eq=False)
class PlacedScan:
    """The scan of a station, called `name`; X_room = rotation X_camera + t. `folder`: where it is, `known`: what is in
    it, if it has been read.
    """

    name: str
    folder: Path
    place: Motion
    known: FinishedScan | None = None

    @property
    def scan(self) -> FinishedScan:
        """Read each time: a room's are large together. Raises InputError if a file is missing or damaged."""
        return self.known or read_finished_scan(self.folder)


@dataclass(frozen=True)
class FinishedRoom:
    """All lengths are in `unit`."""

    unit: str
    stations: tuple[PlacedScan, ...]


def read_finished_room(folder: Path) -> FinishedRoom | None:
    """None if the folder holds neither. Raises InputError if what it holds is malformed."""
    file = next((folder / name for name in (ROOM_FILE, OBJECT_FILE) if (folder / name).is_file()), None)
    if file is None:
        return None
    stored = read_room(file)
    return FinishedRoom(
        stored.unit, tuple(PlacedScan(each.name, folder / each.folder, each.place) for each in stored.stations)
    )
