"""A result folder read back as scans, each with its pose: one capture, several of a corner, a room's or an object's."""

from dataclasses import dataclass, replace
from pathlib import Path

from calib.geometry import IDENTITY, Pose
from calib.numerics import Floats, Ints
from scanner.errors import InputError
from scanner.io import read_network, read_poses, read_room
from scanner.results.finished_scan import FinishedScan, read_calibration_of, read_finished_scan
from scanner.results.names import (
    CAPTURES_FOLDER,
    CLOUD_FILE,
    MERGED_FILE,
    NETWORK,
    OBJECT,
    POSES_FILE,
    kind_of,
)


@dataclass(frozen=True, eq=False)
class KeptPoints:
    """What steps leave of a scan."""

    number: Ints
    """Of the scan's points, (K,)."""
    points: Floats | None
    """Where they are now, (K, 3) in the camera's frame; None where they were."""


@dataclass(frozen=True, eq=False)
class PlacedScan:
    """The scan of a capture or a station with its pose."""

    name: str
    folder: Path
    place: Pose
    """X_result = R X_camera + t."""
    kept: KeptPoints | None = None
    """None for all points."""

    @property
    def scan(self) -> FinishedScan:
        """Read each time: a room's are large together. Raises InputError if a file is missing or damaged."""
        scan = read_finished_scan(self.folder)
        if self.kept is None:
            return scan
        part = scan[self.kept.number]
        return part if self.kept.points is None else replace(part, points=self.kept.points)


@dataclass(frozen=True)
class FinishedResult:
    """Scans in the frame of their joint cloud."""

    unit: str
    """Of all lengths."""
    stations: tuple[PlacedScan, ...]
    """In the order of their numbers, from 1; none of a network."""
    cloud: Path
    """The file of the cloud of all of them."""
    mesh: Path | None = None
    """The file of their mesh; None unless they are of a room or an object."""
    listing: Path | None = None
    """The file with the poses; None of a single capture."""

    @property
    def is_object(self) -> bool:
        """Whether the stations are those of an object."""
        return self.listing is not None and self.listing.name == OBJECT.listing

    @property
    def is_joined(self) -> bool:
        """Whether the stations are those of a room or an object, whose frame is upright."""
        return self.mesh is not None

    @property
    def stations_before_camera(self) -> tuple[PlacedScan, ...]:
        """The stations in the frame that files are written in: of captures of a corner the newest camera's."""
        if self.is_joined:
            return self.stations
        before = self.stations[-1].place.inverse()
        return tuple(replace(station, place=before @ station.place) for station in self.stations)

    @property
    def of_how_many(self) -> str:
        """' of 3 captures', ' of 6 stations', or '' for a single capture."""
        count = len(self.stations)
        return "" if count == 1 else f" of {count} {'stations' if self.is_joined else 'captures'}"


def read_joined(folder: Path) -> FinishedResult | None:
    """A room or an object; None if the folder holds neither. Raises InputError if its content is malformed."""
    kind = kind_of(folder)
    if kind.mesh is None:
        return None
    stored = read_room(folder / kind.listing)
    stations = (PlacedScan(station.name, folder / station.folder, station.place) for station in stored.stations)
    files = folder / kind.cloud, folder / kind.mesh, folder / kind.listing
    return FinishedResult(stored.unit, tuple(stations), *files)


def read_finished_result(folder: Path, capture: int | None = None) -> FinishedResult:
    """Everything that a result holds, or that one of its captures or stations, by number from 1, in its camera's frame.

    Raises InputError if it is no result, its content is malformed, there is no such capture, or if there are several
    captures that were not merged.
    """
    joined = read_joined(folder)
    folders = capture_folders(folder) if joined is None else [station.folder for station in joined.stations]
    count = len(folders)
    if capture is not None and not 1 <= capture <= count:
        raise InputError(f"{folder}: has {count} captures: expected --capture 1 to {count}, found {capture}")
    if joined is not None and capture is None:
        return joined
    if kind_of(folder) is NETWORK:
        listing = folder / NETWORK.listing
        return FinishedResult(read_network(listing).unit, (), folder / NETWORK.cloud, listing=listing)
    unit = read_calibration_of(folder).unit
    if capture is not None or count == 1:
        number = capture or 1
        station = PlacedScan(f"capture {number}", folders[number - 1], IDENTITY)
        return FinishedResult(unit, (station,), station.folder / CLOUD_FILE)
    if not is_merged(folder):
        raise InputError(
            f"{folder}: its {count} captures were not merged (its report says why); choose one with "
            f"--capture 1 to {count}"
        )
    poses = read_poses(folder / POSES_FILE, count)
    placed = enumerate(zip(folders, poses, strict=True), start=1)
    stations = tuple(PlacedScan(f"capture {n}", path, pose) for n, (path, pose) in placed)
    return FinishedResult(unit, stations, folder / MERGED_FILE, listing=folder / POSES_FILE)


def is_merged(folder: Path) -> bool:
    """Whether the captures of a corner have one cloud."""
    return (folder / MERGED_FILE).is_file() and (folder / POSES_FILE).is_file()


def capture_folders(folder: Path) -> list[Path]:
    """The folders of a result's captures, oldest first: the newest is the result itself."""
    earlier = [path for path in (folder / CAPTURES_FOLDER).glob("*") if path.name.isdecimal() and path.is_dir()]
    return [*sorted(earlier, key=lambda path: int(path.name)), folder]
