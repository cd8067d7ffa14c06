"""Points of a result's scans in one frame, and what is measured between them: the errors of poses are in the sigmas."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
import scipy

from calib.diagnostics import Budget, PoseErrors, SystematicErrors, budget_across
from calib.geometry import Matches
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.measuring.measurements import DistanceMeasurement, PointAngle
from scanner.results import FinishedResult, FinishedScan, PlacedScan, read_pose_errors

# Sine below which three points are collinear, where an angle has no derivative.
_LEAST_ACROSS = 1e-6


class PointNumber(NamedTuple):
    """A point of a scan, both counted from 0."""

    station: int
    point: int


@dataclass(frozen=True, eq=False)
class PlacedPoints:
    """The points of scans in the frame of their poses."""

    unit: str
    stations: tuple[PlacedScan, ...]
    errors: SystematicErrors
    """What all scans share."""
    poses: PoseErrors | None
    """None for a single scan, and where they are not known."""

    @classmethod
    def of(cls, result: FinishedResult, errors: SystematicErrors) -> "PlacedPoints":
        """The points of a result. Raises InputError."""
        poses = None
        if result.listing is not None:
            poses = read_pose_errors(result.listing, len(result.stations), errors.calibration.pose.translation)
        return cls(result.unit, result.stations, errors, poses)

    @cached_property
    def _scans(self) -> "_Scans":
        return _Scans(self.stations)

    def scan(self, station: int) -> FinishedScan:
        """A station's scan, read once. Raises InputError."""
        return self._scans.read(station)

    def position(self, number: PointNumber) -> Floats:
        """Where a point is, (3,)."""
        position: Floats = self.stations[number.station].place @ self.scan(number.station).points[number.point]
        return position

    def name(self, number: PointNumber) -> str:
        """'pixel (300, 160)', or of the second of several scans '2: pixel (300, 160)'."""
        column, row = self.scan(number.station).pixel[number.point]
        scan = f"{number.station + 1}: " if len(self.stations) > 1 else ""
        return f"{scan}pixel ({column}, {row})"

    def at_pixel(self, station: int, at: tuple[float, float]) -> PointNumber:
        """The point of a scan's camera pixel (x, y). Raises InputError if it has none."""
        scan, (x, y) = self.scan(station), at
        width, height = scan.calibration.camera.size
        where = f"--distance: pixel ({x:g}, {y:g})"
        if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
            raise InputError(f"{where} is outside of the camera's image, which is {width} × {height} pixels")
        nearest = int(np.argmin(np.linalg.norm(scan.pixel - np.array(at), axis=1)))
        column, row = scan.pixel[nearest]
        if max(abs(column - x), abs(row - y)) > 0.5:
            raise InputError(f"{where} has no point; the nearest pixel that has one is ({column}, {row})")
        return PointNumber(station, nearest)

    def nearest(self, place: Floats) -> PointNumber:
        """The point of any scan that is nearest to a place (3,) in the frame."""
        candidates = []
        for number, station in enumerate(self.stations):
            apart, point = self._scans.tree(number).query(station.place.inverse() @ place)
            candidates.append((float(apart), PointNumber(number, int(point))))
        return min(candidates)[1]

    def distance(self, ends: tuple[PointNumber, PointNumber]) -> DistanceMeasurement:
        """Between two different points."""
        points = np.stack([self.position(end) for end in ends])
        apart = points[1] - points[0]
        distance = float(np.linalg.norm(apart))
        along = apart / distance
        names = (self.name(ends[0]), self.name(ends[1]))
        return DistanceMeasurement(names, points, distance, self._budget(ends, np.stack([-along, along])))

    def angle(self, ends: tuple[PointNumber, PointNumber, PointNumber]) -> PointAngle:
        """At the second of three different points, between the lines to the others."""
        points = np.stack([self.position(end) for end in ends])
        to_first, to_last = points[0] - points[1], points[2] - points[1]
        first, last = to_first / np.linalg.norm(to_first), to_last / np.linalg.norm(to_last)
        cosine, sine = float(first @ last), float(np.linalg.norm(np.cross(first, last)))
        # An end that moves by d perpendicular to its line rotates the line by d over its length.
        by_first = (cosine * first - last) / (max(sine, _LEAST_ACROSS) * np.linalg.norm(to_first))
        by_last = (cosine * last - first) / (max(sine, _LEAST_ACROSS) * np.linalg.norm(to_last))
        gradient = np.degrees(np.stack([by_first, -by_first - by_last, by_last]))
        angle_deg = float(np.degrees(np.arctan2(sine, cosine)))
        return PointAngle(points, angle_deg, self._budget(ends, gradient))

    def _budget(self, ends: Sequence[PointNumber], gradient: Floats) -> Budget | None:
        """The error budget of a number that depends on points (n) by `gradient` (n, 3); None where the noise of the
        points is unknown, or that of the poses, if they are of several scans.
        """
        matches = [self.scan(end.station).matches[np.array([end.point])] for end in ends]
        several = len({end.station for end in ends}) > 1
        sigmas = [match.sigma_px for match in matches]
        if any(sigma is None for sigma in sigmas) or (several and self.poses is None):
            return None
        return budget_across(
            Matches(
                np.concatenate([match.camera_px for match in matches]),
                np.concatenate([match.projector_px for match in matches]),
            ),
            np.concatenate([sigma for sigma in sigmas if sigma is not None]),
            [self.stations[end.station].place for end in ends],
            [end.station for end in ends],
            gradient,
            self.errors,
            self.poses if several else None,
        )


class _Scans:
    """Scans that are read when they are wanted, with trees of their points."""

    def __init__(self, stations: Sequence[PlacedScan]) -> None:
        self.read = cache(lambda station: stations[station].scan)
        self.tree = cache(lambda station: scipy.spatial.cKDTree(self.read(station).points))
