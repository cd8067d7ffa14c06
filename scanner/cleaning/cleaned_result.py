"""A result as its steps leave it: its scans, each with its pose, and its cloud.

The floor of a cloud as its origin: z up, x to the right of the newest camera, which is above the origin.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.deferred_imports import open3d
from calib.geometry import IDENTITY, Pose
from calib.numerics import Floats, Ints
from calib.pointcloud import point_covariances
from scanner.cleaning.clouds import WorkedCloud, do_steps
from scanner.configuration import CloudStep
from scanner.errors import InputError
from scanner.io import read_cloud, read_frame
from scanner.results import (
    FinishedResult,
    FinishedScan,
    KeptPoints,
    PlacedScan,
    is_merged,
    kind_of,
    read_finished_result,
    read_steps,
)

KNOWN_UP_DEG, CAMERA_UP_DEG = 20.0, 60.0  # how far the floor may be from level: by the room, by a tilted camera
_SAMPLE = 50_000
_TRIALS = 1000
_FEWEST = 100
_THICK = 0.005  # of the cloud's extent
_OWN_FRAME = "own frame: the axes that the steps of this result give it"


def floor_axes(points: Floats, normals: Floats, up: Floats, within_deg: float, eye: Pose) -> Pose:
    """X_floor = pose @ X of points (N, 3) with normals; `up` (3,) is upwards within so many degrees, `eye` the
    camera's pose, X = eye @ X_camera. Raises InputError if there is no floor.
    """
    steep = np.cos(np.radians(within_deg))
    level = points[normals @ up > steep]
    below = level[(level - eye.translation) @ up < 0]
    if len(below) < _FEWEST:
        raise InputError(
            f"no floor is found: expected {_FEWEST} points or more on a level surface below the camera, found "
            f"{len(below)}; give three points with --axes instead"
        )
    o3d = open3d()
    o3d.utility.random.seed(0)
    some = below[:: max(1, len(below) // _SAMPLE)]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(some))
    thick = _THICK * float(np.linalg.norm(np.ptp(points, axis=0)))
    _, on = cloud.segment_plane(thick, 3, _TRIALS)
    floor = some[np.asarray(on, np.int64)]
    middle = floor.mean(axis=0)
    z = np.linalg.svd(floor - middle, full_matrices=False)[2][2]
    z = z if z @ up > 0 else -z
    x = eye.rotation[:, 0] - (eye.rotation[:, 0] @ z) * z
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z])
    origin = eye.translation - ((eye.translation - middle) @ z) * z
    return Pose(rotation, -rotation @ origin)


@dataclass(frozen=True, eq=False)
class CleanedCloud:
    """What the steps leave of a cloud, in their axes and the result's unit."""

    points: Floats
    """(N, 3)."""
    normals: Floats
    """(N, 3)."""
    colours: NDArray[np.uint8]
    """(N, 3) RGB."""
    match: Ints | None
    """Numbers of the matches that the points come from, (N,), where the file says so."""
    unit: str
    """Of the points."""
    frame: str
    """The axes in words."""

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, eq=False)
class CleanedResult:
    """A result and its steps."""

    whole: FinishedResult
    """As it was measured."""
    stations: tuple[PlacedScan, ...]
    """Its scans as the steps leave them, where they leave any points, in their axes."""
    steps: tuple[CloudStep, ...]
    """In their order."""
    axes: Pose | None
    """X = axes @ X_result, z up; None for the result's own axes."""
    joint: FinishedResult
    """That of all captures, in whose frame the steps are."""
    worked: tuple[WorkedCloud, ...] = ()
    """Of a single capture, what `clouds` gives; otherwise nothing."""

    @property
    def unit(self) -> str:
        """Of all lengths."""
        return self.whole.unit

    @property
    def is_upright(self) -> bool:
        """Whether z is up in its frame."""
        return self.axes is not None or self.whole.is_joined

    @property
    def has_upright_cloud(self) -> bool:
        """Whether z is up in the joint cloud: not in a camera's frame, as of one capture or a network."""
        return self.axes is not None or (self.whole.listing is not None and bool(self.whole.stations))

    @property
    def of_how_many(self) -> str:
        """' of 3 captures', ' of 6 stations', or '' for a single capture."""
        return self.whole.of_how_many

    @property
    def stations_before_camera(self) -> tuple[PlacedScan, ...]:
        """The scans in the frame that files are written in. Raises InputError for a network, which has none."""
        if not self.stations:
            raise InputError(
                f"{self.whole.cloud.parent}: a network has one cloud, without a camera's pixels: export it as ply, "
                "pcd, las, usd, mesh, stl, 3mf or mapping"
            )
        if self.axes is not None or self.whole.is_joined:
            return self.stations
        before = self.whole.stations[-1].place.inverse()
        return tuple(replace(station, place=before @ station.place) for station in self.stations)

    def floor(self) -> Pose:
        """The axes that `floor` gives, X = pose @ X_result. Raises InputError if there is no floor."""
        return _floor(self.joint)

    def clouds(self) -> list[WorkedCloud]:
        """The joint cloud, and what each step leaves of it. Raises InputError."""
        if self.worked:
            return [*self.worked]
        cloud, place = read_cloud(self.whole.cloud), IDENTITY
        alone = self.whole.listing is None and len(self.whole.stations) == 1
        if alone:
            (station,) = self.whole.stations
            place = next(each.place for each in self.joint.stations if each.folder == station.folder)
        smooths = any(step.smooth for step in self.steps)
        covariances = _covariances(self.whole.stations[0].scan, IDENTITY) if alone and smooths else None
        start = _start(self.joint, place @ cloud.points, place.rotate(cloud.normals), covariances)
        start = replace(start, frame=place, floor=lambda: _floor(self.joint) @ place)
        return [start, *do_steps(start, self.steps)]

    def cloud(self) -> CleanedCloud:
        """What they leave of the joint cloud. Raises InputError."""
        whole, frame = read_cloud(self.whole.cloud), read_frame(self.whole.cloud)
        if not self.steps:
            return CleanedCloud(whole.points, whole.normals, whole.colours, whole.match, self.unit, frame)
        last = self.clouds()[-1]
        points, normals = last.points, last.normals
        if self.axes is None:
            back = last.frame.inverse()
            points = back @ points if last.moved else whole.points[last.number]
            normals = whole.normals[last.number]
        match = None if whole.match is None else whole.match[last.number]
        words = frame if self.axes is None else _OWN_FRAME
        return CleanedCloud(points, normals, whole.colours[last.number], match, self.unit, words)


def read_cleaned(
    folder: Path, capture: int | None = None, steps: Sequence[CloudStep] | None = None, *, own_axes: bool = False
) -> CleanedResult:
    """A result, or one of its captures, as of `read_finished_result`; its own `steps` unless others are given.

    `own_axes`: in the axes of the result, whatever the steps say. Raises InputError, also if a step cannot be done.
    """
    steps = read_steps(folder) if steps is None else tuple(steps)
    whole = read_finished_result(folder, capture)
    has_joint = is_merged(folder) or kind_of(folder).is_joined
    joint = read_finished_result(folder) if capture is not None and has_joint else whole
    changes_axes = not own_axes and any(step.name in ("floor", "axes") for step in steps)
    if not steps or not whole.stations:
        cleaned = CleanedResult(whole, whole.stations, steps, None, joint)
        return replace(cleaned, axes=cleaned.clouds()[-1].frame) if changes_axes else cleaned
    stations, clouds = _cleaned(whole, joint, steps)
    # The points of a single capture are those of its cloud.
    worked = tuple(clouds) if joint is whole and whole.listing is None else ()
    if changes_axes:
        return CleanedResult(whole, stations, steps, clouds[-1].frame, joint, worked)
    own = {station.folder: station.place for station in whole.stations}
    stations = tuple(replace(station, place=own[station.folder]) for station in stations)
    return CleanedResult(whole, stations, steps, None, joint, worked)


def _cleaned(
    whole: FinishedResult, joint: FinishedResult, steps: Sequence[CloudStep]
) -> tuple[tuple[PlacedScan, ...], list[WorkedCloud]]:
    """The scans of a result that have points after the steps, in their axes; all points, and what each step leaves."""
    wanted = {station.folder for station in whole.stations}
    stations = [station for station in joint.stations if station.folder in wanted]
    scans = [station.scan for station in stations]
    placed = list(zip([station.place for station in stations], scans, strict=True))
    points = np.concatenate([place @ scan.points for place, scan in placed])
    normals = np.concatenate([place.rotate(scan.normals) for place, scan in placed])
    covariances = _covariances(scans[0], stations[0].place) if len(scans) == 1 else None
    begun = _start(joint, points, normals, covariances)
    clouds = [begun, *do_steps(begun, steps)]
    last = clouds[-1]
    ends = np.cumsum([0, *map(len, scans)])
    kept = []
    for station, start, end in zip(stations, ends, ends[1:], strict=False):
        own = np.flatnonzero((last.number >= start) & (last.number < end))
        if len(own):
            place = last.frame @ station.place
            moved = place.inverse() @ last.points[own] if last.moved else None
            kept.append(replace(station, place=place, kept=KeptPoints(last.number[own] - start, moved)))
    return tuple(kept), clouds


Covariances = Callable[[Ints], Floats]


def _covariances(scan: FinishedScan, place: Pose) -> Covariances | None:
    """Of a scan's points by their matches, turned by its pose; None where the matches have no sigma."""
    if scan.matches.sigma_px is None:
        return None

    def covariances(chosen: Ints) -> Floats:
        own = point_covariances(scan.matches[chosen], scan.calibration)
        turned: Floats = place.rotation @ own @ place.rotation.T
        return turned

    return covariances


def _start(result: FinishedResult, points: Floats, normals: Floats, covariances: Covariances | None) -> WorkedCloud:
    if not len(points):
        raise InputError(f"{result.cloud}: the cloud is empty")
    everything = np.arange(len(points))
    return WorkedCloud(result.unit, points, normals, everything, IDENTITY, False, covariances, lambda: _floor(result))


def _floor(result: FinishedResult) -> Pose:
    """Of the joint cloud, so that it is the same for every part of it."""
    cloud = read_cloud(result.cloud)
    eye = result.stations[-1].place if result.stations else IDENTITY
    if not result.stations or result.listing is None:
        return floor_axes(cloud.points, cloud.normals, np.array([0.0, -1.0, 0.0]), CAMERA_UP_DEG, eye)
    # The most upright edge of a corner may point down.
    down = not result.is_joined and np.median(cloud.points[:, 2]) < 0
    return floor_axes(cloud.points, cloud.normals, np.array([0.0, 0.0, -1.0 if down else 1.0]), KNOWN_UP_DEG, eye)
