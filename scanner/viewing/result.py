"""A result folder as something to look at: its clouds, each with the rigs that saw it, the camera's picture under white
light, and a network's cloud with all its devices.
"""

from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calib.diagnostics import Uncertainty
from calib.geometry import IDENTITY, Calibration, Matches, Pose
from calib.numerics import Floats
from calib.pointcloud import point_covariances
from scanner.capture import open_capture
from scanner.cleaning import CleanedCloud, read_cleaned
from scanner.errors import InputError
from scanner.io import StoredDevice, read_calibration, read_network
from scanner.measuring import (
    MeasuredScene,
    NetworkPoints,
    PlacedPoints,
    PointNumber,
    has_matches,
    read_scene,
    rig_errors,
)
from scanner.quantities import FACE_NAMES, device_names
from scanner.rendering import LONGEST_SIDE, Pixels, photograph
from scanner.results import (
    CALIBRATION_FILE,
    CAPTURE_FOLDER,
    CAPTURES_FOLDER,
    NETWORK_CLOUD_FILE,
    NETWORK_FILE,
    TRUTH_FILE,
    FinishedResult,
    FinishedScan,
    PlacedScan,
    Verdict,
    capture_folders,
    is_merged,
    read_calibration_of,
    read_finished_result,
    read_finished_scan,
    read_joined,
    read_steps,
    read_uncertainty,
    read_verdict,
)
from scanner.viewing.corner import MeasuredCorner, measured_corner
from scanner.viewing.decimation import shuffled

ALL_CAPTURES, WHOLE_ROOM, WHOLE_THING = "All captures, merged", "The whole room", "The whole thing"
_AT_ONCE = 100_000  # covariances are large


def read_white_picture(folder: Path, longest_side: int = LONGEST_SIDE) -> Pixels | None:
    """RGB (H, W, 3), reduced; None where a result has no recording, or that no white picture."""
    try:
        white = open_capture(folder / CAPTURE_FOLDER).white()
    except InputError:
        return None
    return None if white is None else photograph(white, longest_side)


@dataclass(frozen=True)
class PlacedRig:
    """A rig in a cloud's frame."""

    calibration: Calibration
    pose: Pose
    """X_cloud = R X_camera + t."""
    picture: NDArray[np.uint8] | None
    """(H, W, 3) RGB of the camera, if there is one."""
    names: tuple[str, str] | None = None
    """Of camera and projector, where they have any."""

    @property
    def position(self) -> Floats:
        """The camera's centre in the cloud's frame, (3,)."""
        return self.pose.translation

    @property
    def projector_centre(self) -> Floats:
        """The projector's centre in the cloud's frame, (3,)."""
        return self.pose @ self.calibration.projector_centre


@dataclass(frozen=True, eq=False)
class ViewedCloud:
    """A cloud and its devices, in the cloud's frame, except `corner`, which is in the frame of the first rig.

    `points` (N, 3), `normals` (N, 3), `colours` (N, 3) RGB; `rigs`, the newest first; `up` (3,) points up.
    """

    points: Floats
    normals: Floats
    colours: NDArray[np.uint8]
    rigs: tuple[PlacedRig, ...]
    corner: MeasuredCorner | None
    up: Floats
    unit: str
    frame: Literal["camera", "corner", "room"]
    scans: PlacedPoints | None = field(default=None, kw_only=True)
    """What the cloud was made of, in its frame, to measure in; None if there is nothing."""
    has_walls: bool = field(default=True, kw_only=True)
    """Whether it may be of a room; False of a thing."""

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """The points in an order whose every beginning is an even choice of them, (N,)."""
        return shuffled(len(self.points)).astype(np.int64)

    def point_number(self, index: int) -> PointNumber:
        """The scan's point that a point of the cloud is, or is nearest to. Raises InputError if a scan is damaged."""
        if self.scans is None:
            raise ValueError("there are no scans to measure in")
        return PointNumber(0, index) if len(self.scans.stations) == 1 else self.scans.nearest(self.points[index])


@dataclass(frozen=True, eq=False)
class CloudWithSigma(ViewedCloud):
    """`sigma` (N,): the standard deviation of each point along its ray, in the cloud's unit."""

    sigma: Floats


@dataclass(frozen=True, eq=False)
class DeviationCloud(ViewedCloud):
    """Points that were compared with a reference."""

    deviation: Floats = field(kw_only=True)
    """(N,): signed distance of each point from the reference, NaN where that has no surface."""
    tolerance: float | None = field(default=None, kw_only=True)
    """That the deviations were tested against."""


@dataclass(frozen=True, eq=False)
class CaptureCloud(ViewedCloud):
    """The cloud of one capture, with the scan that it is of, and what that has measured."""

    scan: FinishedScan
    scene: MeasuredScene

    @property
    def matches(self) -> Matches:
        """The matches of the points, row by row."""
        return self.scan.matches

    @property
    def uncertainty(self) -> Uncertainty | None:
        """The calibration's uncertainty; None if unknown."""
        return self.scene.errors.uncertainty

    @property
    def has_sigma(self) -> bool:
        """Whether anything is known of how sure the points are."""
        return self.matches.sigma_px is not None or self.uncertainty is not None

    def from_faces(self, chosen: NDArray[np.int64]) -> Floats:
        """Signed distance of points (n,) from the planes that their faces were measured to be, NaN for no face."""
        off = np.full(len(chosen), np.nan)
        labels = self.matches.labels[chosen]
        for face in self.scene.faces:
            on = labels == FACE_NAMES.index(face.name)
            off[on] = self.points[chosen[on]] @ face.normal - face.offset
        return off

    def depth_sigma(self, chosen: NDArray[np.int64]) -> Floats:
        """Standard deviation of the depth of points (n,), in `unit`.

        From the matches' noise and the covariance of the calibration; from the noise alone where that is not known.
        """
        sigma = np.empty(len(chosen))
        for start in range(0, len(chosen), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            matches = self.matches[chosen[part]]
            if self.uncertainty is None:
                sigma[part] = np.sqrt(point_covariances(matches, self.scan.calibration)[:, 2, 2])
            else:
                sigma[part] = self.scan.calibration.baseline * self.uncertainty.of_points(matches)[:, 2]
        return sigma


class ViewedResult:
    """A result folder, read on demand. Raises InputError if it is not one, or if its capture was refused."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.calibration = read_calibration_of(folder)
        self._room = read_joined(folder)
        self.steps = read_steps(folder)
        truth = folder / TRUTH_FILE
        self.truth = read_calibration(truth) if truth.is_file() else None
        self.names = self._names()
        self.cloud = cache(self._cloud)

    @cached_property
    def verdict(self) -> Verdict | None:
        """The verdict of the report; None if the result has none."""
        return read_verdict(self.folder / CALIBRATION_FILE)

    def _names(self) -> tuple[str, ...]:
        """Return the names of the clouds, the best first."""
        if self._room is not None:
            return (WHOLE_THING if self._room.is_object else WHOLE_ROOM, *self._captures)
        merged = (ALL_CAPTURES,) if is_merged(self.folder) else ()
        return (*merged, *self._captures)

    @cached_property
    def _captures(self) -> dict[str, Path]:
        """Folders of the captures by their names, the newest first; of a room's stations in their order."""
        if self._room is not None:
            return {f"{n}: {station.name}": station.folder for n, station in enumerate(self._room.stations, start=1)}
        folders = capture_folders(self.folder)
        return {self._title(n, len(folders)): path for n, path in reversed([*enumerate(folders, start=1)])}

    def _title(self, number: int, among: int) -> str:
        if self.calibration.one_camera:
            return " and ".join(device_names(self.calibration, number, among)).capitalize()
        return f"Capture {number}" if among > 1 else "The capture"

    def _cloud(self, name: str) -> ViewedCloud:
        """Read the cloud called `name`. Raises InputError if its files are missing or damaged."""
        if name == ALL_CAPTURES:
            return self._merged()
        if name in (WHOLE_ROOM, WHOLE_THING) and self._room is not None:
            return self._whole(self._room)
        folder = self._captures[name]
        measured = read_finished_scan(folder)
        alone = self._cleaned(PlacedScan(name, folder, IDENTITY))
        scan = measured if alone.kept is None else alone.scan
        # The stations of a room do not repeat how uncertain their common calibration is.
        scene = read_scene(self.folder if self._room else folder, scan.calibration, folder)
        corner = measured_corner(measured, scene)
        return CaptureCloud(
            scan.points,
            scan.normals,
            scan.colours,
            (PlacedRig(scan.calibration, IDENTITY, _picture(folder, scan)),),
            corner,
            _up(corner),
            scan.unit,
            "camera",
            scan,
            scene,
            scans=PlacedPoints(scan.unit, (alone,), scene.errors, None),
        )

    def number_of(self, name: str) -> int | None:
        """Of the capture or station whose cloud is called so, from 1; None of all of them."""
        if name not in self._captures:
            return None
        joined = [] if self._room is None else [station.folder for station in self._room.stations]
        return 1 + (joined or capture_folders(self.folder)).index(self._captures[name])

    def _cleaned(self, capture: PlacedScan) -> PlacedScan:
        """What the steps of the result leave of a capture, in its camera's frame."""
        if not self.steps:
            return capture
        (station,) = read_cleaned(self.folder, self.number_of(capture.name), self.steps, own_axes=True).stations
        return replace(capture, kept=station.kept)

    def _whole(self, room: FinishedResult) -> ViewedCloud:
        cloud, rigs = self._whole_cloud(), self._rigs(room)
        up = np.array([0.0, 0.0, 1.0])
        errors = rig_errors(self.calibration, read_uncertainty(self.folder / CALIBRATION_FILE, self.calibration))
        scans = PlacedPoints.of(room, errors)
        return ViewedCloud(
            cloud.points,
            cloud.normals,
            cloud.colours,
            rigs,
            None,
            up,
            room.unit,
            "room",
            scans=scans,
            has_walls=not room.is_object,
        )

    def _merged(self) -> ViewedCloud:
        result = read_finished_result(self.folder)
        rigs = self._rigs(result)
        newest = result.stations[-1].scan
        scene = read_scene(self.folder, newest.calibration)
        corner = measured_corner(newest, scene)
        cloud = self._whole_cloud()
        up = np.array([0.0, 0.0, 1.0 if np.median(cloud.points[:, 2]) >= 0 else -1.0])
        scans = PlacedPoints.of(result, scene.errors)
        return ViewedCloud(
            cloud.points, cloud.normals, cloud.colours, rigs, corner, up, result.unit, "corner", scans=scans
        )

    def _whole_cloud(self) -> CleanedCloud:
        cleaned = read_cleaned(self.folder, steps=self.steps, own_axes=True)
        cloud = cleaned.cloud()
        if not len(cloud):
            raise InputError(f"{cleaned.whole.cloud}: the cloud is empty")
        return cloud

    @staticmethod
    def _rigs(result: FinishedResult) -> tuple[PlacedRig, ...]:
        """Of all scans, the newest first."""
        placed = ((station, station.scan) for station in reversed(result.stations))
        return tuple(
            PlacedRig(scan.calibration, station.place, _picture(station.folder, scan)) for station, scan in placed
        )


def _up(corner: MeasuredCorner | None) -> Floats:
    """Upwards in the camera's frame: the most upright edge of the corner, or the camera's own."""
    return np.array([0.0, -1.0, 0.0]) if corner is None else corner.corner.up


def _picture(folder: Path, scan: FinishedScan) -> NDArray[np.uint8]:
    """The camera's picture of the lit scene, RGB, reduced: the recording's white one, or else the points' colours."""
    recorded = read_white_picture(folder)
    if recorded is not None:
        return recorded
    camera = scan.calibration.camera
    picture = np.zeros((camera.height, camera.width, 3), np.uint8)
    picture[scan.pixel[:, 1], scan.pixel[:, 0]] = scan.colours[:, ::-1]
    return photograph(picture)


def network_cloud(folder: Path) -> ViewedCloud:
    """Read it, in the frame of the first device. Raises InputError if a file is missing or damaged."""
    cloud, network = read_cleaned(folder, own_axes=True).cloud(), read_network(folder / NETWORK_FILE)
    if not len(cloud):
        raise InputError(f"{folder / NETWORK_CLOUD_FILE}: the cloud is empty")
    cameras, projectors = (
        [device for device in network.devices if device.kind == kind] for kind in ("camera", "projector")
    )
    if not (cameras and projectors):
        raise InputError(f"{folder / NETWORK_FILE}: expected a camera and a projector or more")
    # Every device once, or more often where there are more of the other kind.
    rigs = tuple(
        _rig(cameras[number % len(cameras)], projectors[number % len(projectors)], network.unit, folder)
        for number in range(max(len(cameras), len(projectors)))
    )
    up = np.array([0.0, -1.0, 0.0])
    scans = NetworkPoints.read(folder) if has_matches(folder) else None
    return ViewedCloud(cloud.points, cloud.normals, cloud.colours, rigs, None, up, network.unit, "camera", scans=scans)


def _rig(camera: StoredDevice, projector: StoredDevice, unit: str, folder: Path) -> PlacedRig:
    to_projector = projector.place.inverse() @ camera.place
    calibration = Calibration(camera.intrinsics, projector.intrinsics, to_projector, unit)
    picture = read_white_picture(folder / CAPTURES_FOLDER / f"{camera.name}-{projector.name}")
    return PlacedRig(calibration, camera.place, picture, (camera.name, projector.name))
