"""Points of a result's scans in one frame, and what is measured between them: the errors of poses are in the sigmas.

Points of a network's pairs in its frame, and distances between them, with the errors of all devices and poses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy

from calib.diagnostics import Budget, PoseErrors, SystematicErrors, budget_across, spread_of_points
from calib.geometry import Calibration, Intrinsics, Matches, intersect
from calib.networks import PER_NODE, PLACE, Device, point_slopes
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, StoredDevice, StoredNetwork, read_matches, read_network
from scanner.measuring.measurements import DistanceMeasurement, PointAngle
from scanner.results import (
    CAPTURES_FOLDER,
    NETWORK_FILE,
    FinishedResult,
    FinishedScan,
    NetworkErrors,
    PlacedScan,
    read_network_errors,
    read_pose_errors,
)

# Sine below which three points are collinear, where an angle has no derivative.
_LEAST_ACROSS = 1e-6
_GREY = 128


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


@dataclass(frozen=True, eq=False)
class PairScan(PlacedScan):
    """What a camera sees of a projector's light, with the network's calibration of both."""

    calibration: Calibration = field(kw_only=True)
    """Of the pair."""
    devices: tuple[int, int] = field(kw_only=True)
    """Numbers of the camera and the projector in the network."""

    @property
    def scan(self) -> FinishedScan:
        """All matches before both devices, as points without normals. Raises InputError."""
        matches = read_matches(self.folder)
        met = intersect(matches, self.calibration)
        kept = np.flatnonzero(met.in_front)
        points = met.points[kept]
        pixel = np.rint(matches.camera_px[kept]).astype(np.int64)
        colours = np.full(points.shape, _GREY, np.uint8)
        return FinishedScan(
            self.calibration, matches[kept], len(matches), points, np.zeros_like(points), colours, pixel
        )


@dataclass(frozen=True, eq=False)
class NetworkPoints(PlacedPoints):
    """The points of all pairs of a network, in its frame."""

    network: StoredNetwork = field(kw_only=True)
    network_errors: NetworkErrors | None = field(kw_only=True)
    """None where the file states none."""

    @classmethod
    def read(cls, folder: Path) -> "NetworkPoints":
        """Of a network's result. Raises InputError if its files are malformed, or no pair has matches."""
        network = read_network(folder / NETWORK_FILE)
        pairs = tuple(_pairs(folder, network))
        if not pairs:
            raise InputError(
                f"{folder}: has no {CAPTURES_FOLDER}/<camera>-<projector>/{MATCHES_FILE} to measure in, as results of "
                "earlier versions: make it again with scan network"
            )
        errors = SystematicErrors.of(pairs[0].calibration, None)
        stated = read_network_errors(folder / NETWORK_FILE, [device.name for device in network.devices])
        return cls(network.unit, pairs, errors, None, network=network, network_errors=stated)

    def name(self, number: PointNumber) -> str:
        """'left-stage: pixel (300, 160)'."""
        column, row = self.scan(number.station).pixel[number.point]
        return f"{self.stations[number.station].name}: pixel ({column}, {row})"

    @cached_property
    def devices(self) -> list[Device]:
        """In the order of the file."""
        return [
            Device(_lens(device.intrinsics), device.place, device.intrinsics.size) for device in self.network.devices
        ]

    def _budget(self, ends: Sequence[PointNumber], gradient: Floats) -> Budget | None:
        """The error budget of a number that depends on points (n) by `gradient` (n, 3): `calibration` contains the
        devices' poses.
        """
        stated = self.network_errors
        if stated is None:
            return None
        slopes = np.zeros(PER_NODE * len(self.devices))
        scatter = smooth = 0.0
        for end, part in zip(ends, gradient, strict=True):
            pair, scan = self.stations[end.station], self.scan(end.station)
            match = scan.matches[np.array([end.point])]
            if not isinstance(pair, PairScan) or match.sigma_px is None:
                return None
            slopes += part @ point_slopes(self.devices, pair.devices, match.camera_px[0], match.projector_px[0])
            of_rig = SystematicErrors.of(pair.calibration, None)
            of_point = spread_of_points(match, of_rig, match.sigma_px)
            budget = of_point.through((pair.place.rotation.T @ part)[None]).budget()
            scatter, smooth = np.hypot(scatter, budget.scatter), np.hypot(smooth, budget.smooth)
        slopes += self._by_scale(ends, gradient, stated)
        variance = float(slopes @ stated.covariance @ slopes)
        return Budget(float(scatter), float(smooth), float(np.sqrt(max(variance, 0.0))), 0.0)

    def _by_scale(self, ends: Sequence[PointNumber], gradient: Floats, stated: NetworkErrors) -> Floats:
        """What is scaled so that a known distance is as known: the derivative by the places of its devices."""
        slopes = np.zeros(PER_NODE * len(self.devices))
        names = [device.name for device in self.network.devices]
        first, second = (names.index(name) for name in stated.known_distance or names[:2])
        apart = self.devices[second].pose.translation - self.devices[first].pose.translation
        by_log_scale = float(np.sum(gradient * np.stack([self.position(end) for end in ends])))
        toward = by_log_scale * apart / float(apart @ apart)
        slopes[PER_NODE * first :][PLACE] += toward
        slopes[PER_NODE * second :][PLACE] -= toward
        return slopes


def has_matches(folder: Path) -> bool:
    """Whether a network's result holds what was decoded of any pair, which earlier versions did not keep."""
    return any((folder / CAPTURES_FOLDER).glob(f"*/{MATCHES_FILE}"))


def _lens(device: Intrinsics) -> Floats:
    return np.array([device.focal_px[0], *device.principal_point_px, *device.distortion])


def _pairs(folder: Path, network: StoredNetwork) -> list[PairScan]:
    """Those of the network's pairs whose matches were kept."""
    numbered = list(enumerate(network.devices))
    kept = []
    for p, projector in numbered:
        for c, camera in numbered:
            if (camera.kind, projector.kind) != ("camera", "projector"):
                continue
            name = f"{camera.name}-{projector.name}"
            if (folder / CAPTURES_FOLDER / name / MATCHES_FILE).is_file():
                rig = _rig(camera, projector, network.unit)
                place = folder / CAPTURES_FOLDER / name
                kept.append(PairScan(name, place, camera.place, calibration=rig, devices=(c, p)))
    return kept


def _rig(camera: StoredDevice, projector: StoredDevice, unit: str) -> Calibration:
    to_projector = projector.place.inverse() @ camera.place
    return Calibration(camera.intrinsics, projector.intrinsics, to_projector, unit)
