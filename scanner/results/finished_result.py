"""A result folder read back as scans, each with its pose: one capture, several of a corner, a room's or an object's.

A scan has its calibration, and the cloud with the camera pixel and the match of every point. What results of earlier
versions do not say is found again.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.geometry import IDENTITY, Calibration, Matches, Pose, intersect
from calib.numerics import Bools, Floats, Ints
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, read_calibration, read_cloud, read_matches, read_network, read_poses, read_room
from scanner.results.names import (
    CALIBRATION_FILE,
    CAPTURES_FOLDER,
    CLOUD_FILE,
    MERGED_FILE,
    NETWORK,
    OBJECT,
    POSES_FILE,
    kind_of,
)

# Cloud coordinates are rounded to 24 bits, far less than this share of a point's distance.
_SAME_POINT = 1e-5
# This many points of a cloud suffice to check that it comes from these matches.
_SAMPLE = 1000


def same_points(points: Floats, others: Floats) -> Bools:
    """Which points (N, 3) of a file are those others, (N,), but for the file's rounding."""
    apart = np.linalg.norm(others - points, axis=1)
    same: Bools = apart <= _SAME_POINT * np.linalg.norm(points, axis=1)
    return same


def find_matches(points: Floats, matches: Matches, calibration: Calibration) -> Ints | None:
    """Which match each point (N, 3) was triangulated from, (N,), or None if there is a point that none gives."""
    met = intersect(matches, calibration)
    usable = np.flatnonzero(met.in_front)
    if not len(usable):
        return None
    nearest = usable[scipy.spatial.cKDTree(met.points[usable]).query(points)[1]]
    return nearest if np.all(same_points(points, met.points[nearest])) else None


@dataclass(frozen=True)
class FinishedScan:
    """A finished scan, as read from its files. Row i of every array, and match i, belong to one point."""

    calibration: Calibration
    matches: Matches
    matched: int
    """How many matches the scan had."""
    points: Floats
    """In the camera's frame and the calibration's unit, (N, 3)."""
    normals: Floats
    """(N, 3)."""
    colours: NDArray[np.uint8]
    """RGB, (N, 3)."""
    pixel: Ints
    """Column and row of the camera's image, no two alike, (N, 2)."""

    def __len__(self) -> int:
        return len(self.points)

    @property
    def unit(self) -> str:
        """The unit of `points`; 'baseline' if no length is known."""
        return self.calibration.unit

    def __getitem__(self, chosen: Ints) -> "FinishedScan":
        """The points of these numbers (K,), with everything that belongs to them."""
        return replace(
            self,
            matches=self.matches[chosen],
            points=self.points[chosen],
            normals=self.normals[chosen],
            colours=self.colours[chosen],
            pixel=self.pixel[chosen],
        )


def read_calibration_of(folder: Path) -> Calibration:
    """The calibration of a result folder. Raises InputError if it is no result or its capture was refused."""
    if (folder / CALIBRATION_FILE).is_file():
        return read_calibration(folder / CALIBRATION_FILE)
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a result folder, found {'a file' if folder.exists() else 'nothing'}")
    if (folder / MATCHES_FILE).is_file():
        raise InputError(
            f"{folder}: has matches but no {CALIBRATION_FILE}: no trustworthy calibration was possible from this "
            "capture; its report.html says why and what to do"
        )
    raise InputError(f"{folder}: expected a result folder, with {CALIBRATION_FILE} and {CLOUD_FILE}, found neither")


def read_finished_scan(folder: Path) -> FinishedScan:
    """Everything of a result folder but the recording. Raises InputError if a file is missing or of another scan."""
    calibration = read_calibration_of(folder)
    cloud = read_cloud(folder / CLOUD_FILE)
    matches = read_matches(folder)
    if not len(cloud):
        raise InputError(f"{folder}: the cloud is empty")
    own = find_matches(cloud.points, matches, calibration) if cloud.match is None else cloud.match
    if own is None or own.min() < 0 or own.max() >= len(matches):
        raise _of_another_scan(folder)
    matched = matches[own]
    pixel = np.rint(matched.camera_px).astype(np.int64)
    if not _has_own_pixels(pixel, calibration) or not _is_where_rays_meet(cloud.points, matched, calibration):
        raise _of_another_scan(folder)
    return FinishedScan(calibration, matched, len(matches), cloud.points, cloud.normals, cloud.colours, pixel)


def _of_another_scan(folder: Path) -> InputError:
    return InputError(
        f"{folder}: {CLOUD_FILE} does not follow from {MATCHES_FILE} and {CALIBRATION_FILE}: one of them was "
        "changed or comes from another scan; make the result again with 'scan replay' or 'scan calibrate'"
    )


def _has_own_pixels(pixel: Ints, calibration: Calibration) -> bool:
    """Whether pixels (N, 2) are in the camera's image and unique."""
    size = calibration.camera.size
    if np.any((pixel < 0) | (pixel >= size)):
        return False
    return len(np.unique(pixel[:, 1] * size.width + pixel[:, 0])) == len(pixel)


def _is_where_rays_meet(points: Floats, matched: Matches, calibration: Calibration) -> bool:
    """Whether points (N, 3) are what their matches give, judged by some of them."""
    sample = np.linspace(0, len(points) - 1, _SAMPLE).astype(np.int64)
    met = intersect(matched[sample], calibration)
    return bool(np.all(met.in_front) and np.all(same_points(points[sample], met.points)))


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
