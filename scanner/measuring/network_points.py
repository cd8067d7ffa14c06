"""Points of a network's pairs in its frame, and distances between them, with the errors of all devices and poses."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from calib.diagnostics import Budget, SystematicErrors, spread_of_points
from calib.geometry import Calibration, Intrinsics, intersect
from calib.networks import PER_NODE, PLACE, Device, point_slopes
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io import MATCHES_FILE, StoredDevice, StoredNetwork, read_matches, read_network
from scanner.measuring.placed_points import PlacedPoints, PointNumber
from scanner.results import (
    CAPTURES_FOLDER,
    NETWORK_FILE,
    FinishedScan,
    NetworkErrors,
    PlacedScan,
    read_network_errors,
)

_GREY = 128


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
