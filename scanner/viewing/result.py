"""A result folder as something to look at: its clouds, each with the rigs that saw it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calib.diagnostics import Uncertainty
from calib.geometry import Calibration, Corner
from calib.numerics import Floats
from calib.pointcloud import point_covariances
from scanner.capture import open_capture
from scanner.errors import InputError
from scanner.io import CloudPoints, read_calibration, read_cloud, read_image, read_matches
from scanner.patterns import White
from scanner.rendering import photograph
from scanner.results import (
    CALIBRATION_FILE,
    CAPTURE_FOLDER,
    CAPTURES_FOLDER,
    CLOUD_FILE,
    MERGED_FILE,
    TRUTH_FILE,
    FinishedScan,
    Verdict,
    read_calibration_of,
    read_finished_scan,
    read_uncertainty,
    read_verdict,
)
from scanner.viewing.corner import MeasuredCorner, measured_corner, triangulated
from scanner.viewing.decimation import shuffled

ALL_CAPTURES = "All captures, merged"
_PLACING_POINTS = 2_000
_PICTURED_POINTS = 500_000
_AT_ONCE = 100_000  # covariances are large


@dataclass(frozen=True)
class PlacedRig:
    """A rig in a cloud's frame: X_cloud = `rotation` X_camera + `position`; `picture` (H, W, 3) RGB is the camera's."""

    calibration: Calibration
    rotation: Floats
    position: Floats
    picture: NDArray[np.uint8]

    @property
    def projector_centre(self) -> Floats:
        """Where the projector is in the cloud's frame, (3,)."""
        return self.to_cloud(self.calibration.projector_centre)

    def to_cloud(self, points: Floats) -> Floats:
        """Points (..., 3) of the camera's frame in the cloud's."""
        return points @ self.rotation.T + self.position


@dataclass(frozen=True, eq=False)
class ViewedCloud:
    """A cloud and what belongs to it, all in the cloud's frame but `corner`, which is in the frame of the first rig.

    `points` (N, 3), `colours` (N, 3) RGB; `up` (3,) points up. What each point was triangulated from takes a while to
    find out for millions, so `read_scan` does that when it is asked for; None for a merged cloud. `has_faces` and
    `has_sigma`: what will be known then. `uncertainty` is the calibration's, where the result knows it.
    """

    points: Floats
    colours: NDArray[np.uint8]
    rigs: tuple[PlacedRig, ...]
    corner: MeasuredCorner | None
    up: Floats
    unit: str
    read_scan: Callable[[], FinishedScan] | None = None
    has_faces: bool = False
    has_sigma: bool = False
    uncertainty: Uncertainty | None = None

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """The points in an order whose every beginning is an even choice of them, (N,)."""
        return shuffled(len(self.points)).astype(np.int64)

    @cached_property
    def scan(self) -> FinishedScan:
        """The same points with their matches. Raises InputError if they do not belong together."""
        if self.read_scan is None:
            raise ValueError("a merged cloud does not know what its points come from")
        return self.read_scan()

    def depth_sigma(self, chosen: NDArray[np.int64]) -> Floats:
        """Standard deviation of the depth of points (n,), in `unit`.

        From the matches' noise and the covariance of the calibration; from the noise alone where that is not known.
        """
        sigma = np.empty(len(chosen))
        for start in range(0, len(chosen), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            matches, calibration = self.scan.matches[chosen[part]], self.scan.calibration
            if self.uncertainty is None:
                sigma[part] = np.sqrt(point_covariances(matches, calibration)[:, 2, 2])
            else:
                sigma[part] = calibration.baseline * self.uncertainty.of_points(matches)[:, 2]
        return sigma


class ViewedResult:
    """A result folder, read as far as it is looked at. Raises InputError if it is none, or its capture was refused."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.calibration = read_calibration_of(folder)
        truth = folder / TRUTH_FILE
        self.truth = read_calibration(truth) if truth.is_file() else None
        self.names = self._names()
        self.cloud = cache(self._cloud)

    @cached_property
    def verdict(self) -> Verdict | None:
        """What the report concludes; None for a result that does not say."""
        return read_verdict(self.folder / CALIBRATION_FILE)

    def _names(self) -> tuple[str, ...]:
        """What can be looked at, the best first."""
        merged = (ALL_CAPTURES,) if (self.folder / MERGED_FILE).is_file() else ()
        return (*merged, *self._captures)

    @cached_property
    def _captures(self) -> dict[str, Path]:
        """Folders of the captures by their names, the newest first."""
        older = [path for path in (self.folder / CAPTURES_FOLDER).glob("*") if path.name.isdecimal() and path.is_dir()]
        older.sort(key=lambda path: int(path.name), reverse=True)
        if not older:
            return {"The capture": self.folder}
        return {f"Capture {len(older) + 1}": self.folder} | {f"Capture {path.name}": path for path in older}

    def _cloud(self, name: str) -> ViewedCloud:
        """What is called `name`. Raises InputError if its files are missing or damaged."""
        if name == ALL_CAPTURES:
            return self._merged()
        folder = self._captures[name]
        points, matches = read_cloud(folder / CLOUD_FILE), read_matches(folder)
        if not len(points):
            raise InputError(f"{folder}: the cloud is empty")
        calibration = read_calibration_of(folder)
        uncertainty = read_uncertainty(folder / CALIBRATION_FILE, calibration)
        corner = measured_corner(matches, calibration)
        return ViewedCloud(
            points.points,
            points.colours,
            (PlacedRig(calibration, np.eye(3), np.zeros(3), _picture(folder, points, calibration)),),
            corner,
            _up(corner),
            calibration.unit,
            partial(read_finished_scan, folder),
            matches.face is not None,
            matches.sigma_px is not None or uncertainty is not None,
            uncertainty,
        )

    def _merged(self) -> ViewedCloud:
        cloud = read_cloud(self.folder / MERGED_FILE)
        if not len(cloud):
            raise InputError(f"{self.folder / MERGED_FILE}: the cloud is empty")
        tree = cKDTree(cloud.points[shuffled(len(cloud))[: 50 * _PLACING_POINTS]])
        rigs, corner = [], None
        for folder in self._captures.values():
            calibration, matches = read_calibration_of(folder), read_matches(folder)
            found = measured_corner(matches, calibration)
            if found is not None:
                _, points = triangulated(matches, calibration, _PLACING_POINTS)
                rotation, position = _place(points, found.corner, tree)
                picture = _picture(folder, read_cloud(folder / CLOUD_FILE), calibration)
                rigs.append(PlacedRig(calibration, rotation, position, picture))
                corner = corner or found
        up = np.array([0.0, 0.0, 1.0 if np.median(cloud.points[:, 2]) >= 0 else -1.0])
        return ViewedCloud(cloud.points, cloud.colours, tuple(rigs), corner, up, self.calibration.unit)


def _up(corner: MeasuredCorner | None) -> Floats:
    """Upwards in the camera's frame: the most upright edge of the corner, or the camera's own."""
    above = np.array([0.0, -1.0, 0.0])
    if corner is None:
        return above
    legs = corner.corner.legs
    steepest: Floats = legs[np.argmax(np.abs(legs @ above))]
    return steepest if steepest @ above > 0 else -steepest


def _place(points: Floats, corner: Corner, tree: cKDTree) -> tuple[Floats, Floats]:
    """Rotation and position of a camera in the merged cloud's frame, which is the corner's: its axes are numbered as
    fits `points` (N, 3) of the camera's frame best.
    """
    legs = corner.legs
    u, _, vt = np.linalg.svd(legs if np.linalg.det(legs) > 0 else legs[[0, 2, 1]])
    turned = [np.roll(u @ vt, turn, axis=0) for turn in range(3)]
    misses = [np.median(tree.query((points - corner.vertex) @ rotation.T)[0]) for rotation in turned]
    rotation: Floats = turned[int(np.argmin(misses))]
    return rotation, -rotation @ corner.vertex


def _picture(folder: Path, cloud: CloudPoints, calibration: Calibration) -> NDArray[np.uint8]:
    """The camera's picture of the lit scene, RGB, reduced: the recording's white one, or else the points' colours."""
    try:
        recording = open_capture(folder / CAPTURE_FOLDER)
        white = next(path for path, shown in zip(recording.files, recording.patterns, strict=True) if shown == White())
        return photograph(read_image(recording.folder / white))
    except (InputError, StopIteration):
        camera = calibration.camera
        seen = np.zeros((camera.height, camera.width, 3), np.uint8)
        some = shuffled(len(cloud))[:_PICTURED_POINTS]
        column, row = np.rint(camera.project(cloud.points[some])).T
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        seen[row[inside].astype(np.int64), column[inside].astype(np.int64)] = cloud.colours[some[inside], ::-1]
        return photograph(seen)
