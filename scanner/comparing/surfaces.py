"""The surfaces that are compared: results, clouds and meshes, with what is known of their errors."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from calib.diagnostics import SystematicErrors
from calib.geometry import Pose
from calib.numerics import Bools, Floats, Ints, evenly_spread, in_slices, is_far
from calib.pointcloud import point_covariances
from calib.registration import SurfacePoints, are_opposed, enclosed_volume, is_closed, sample_mesh
from scanner.cleaning import CleanedResult, read_cleaned
from scanner.errors import InputError
from scanner.exporting import mesh_in_axes
from scanner.io import StoredSurface, read_surface
from scanner.measuring import rig_errors
from scanner.quantities import UNKNOWN_UNIT
from scanner.results import CALIBRATION_FILE, FinishedScan, read_calibration_of, read_uncertainty

NO_UNIT = "units"  # where no file says which
_OF_MESH = 200_000  # points
_EFFECTS = 1500  # points at which the calibration's errors are known
_AT_ONCE = 100_000
_SOME = 0.01  # share of repeated points, above which they are told
_FEWEST = 24  # points of a surface
_OF_SIGNS = 100_000  # points whose normals tell whether their signs mean anything


@dataclass(frozen=True, eq=False)
class CalibrationEffects:
    """What each source of a calibration's errors, of one sigma, does to some points."""

    points: Floats
    """(K, 3)"""
    moved: Floats
    """(K, 3, S)"""


@dataclass(frozen=True, eq=False)
class ComparedSurface:
    """A surface in its own frame and unit."""

    name: str
    points: Floats
    """(N, 3): of the cloud, or the vertices of the mesh."""
    normals: Floats | None
    """(N, 3), of unit length; None where unknown, and of a mesh."""
    triangles: Ints | None
    unit: str | None
    """None where the file does not say; 'baseline' for a result without a known length."""
    eye: Floats | None
    noise: Floats | None
    """(N,): standard deviations along the normals; None where unknown."""
    effects: CalibrationEffects | None
    views: tuple[tuple[Floats, Floats], ...] = ()
    """The scanner's places (3,), each with the points (M, 3) that were seen from it; none where they are not known."""
    notes: tuple[str, ...] = ()

    @property
    def is_mesh(self) -> bool:
        """Whether it has triangles and no measured points."""
        return self.triangles is not None

    @property
    def has_length(self) -> bool:
        """Whether its unit is one of length."""
        return self.unit not in (None, UNKNOWN_UNIT)

    @cached_property
    def is_closed(self) -> bool:
        """Whether it is a mesh of all of a body's surface."""
        return self.triangles is not None and is_closed(self.points, self.triangles)

    @property
    def knows_outside(self) -> bool:
        """Whether its normals are surely on the outer side: of a scan from a known place, or around a volume."""
        return self.is_closed or self.eye is not None or len(self.views) > 0

    @property
    def turned(self) -> "ComparedSurface":
        """With its normals, or its faces, on the other side."""
        triangles = None if self.triangles is None else self.triangles[:, ::-1]
        return replace(self, normals=None if self.normals is None else -self.normals, triangles=triangles)

    @cached_property
    def sampled(self) -> SurfacePoints:
        """For the registration."""
        if self.triangles is not None:
            points, normals = sample_mesh(self.points, self.triangles, _OF_MESH)
            if self.is_closed and enclosed_volume(self.points, self.triangles) < 0:
                normals = -normals
            return SurfacePoints(points, normals, 0.0, is_closed=self.is_closed)
        noise = None if self.noise is None else float(np.median(self.noise))
        return SurfacePoints(self.points, self.normals, noise, self.eye)


def read_compared(path: Path, capture: int | None = None) -> ComparedSurface:
    """A result folder, or a file. Raises InputError."""
    if path.is_dir():
        return _of_result(path, read_cleaned(path, capture))
    stored = read_surface(path)
    if stored.triangles is None and len(stored.points) < _FEWEST:
        found = f"found {len(stored.points)} at different places: too few to be aligned"
        raise InputError(f"{path}: expected a surface, of {_FEWEST} points or more, {found}")
    views = () if stored.eye is None else ((stored.eye, stored.points),)
    normals, notes = stored.normals, [*_notes(path, stored)]
    if normals is not None and are_on_both_sides(stored.points, normals):
        normals = None
        notes.append(f"{path}: its normals are on both sides of the surface, and were not used.")
    return ComparedSurface(
        str(path),
        stored.points,
        normals,
        stored.triangles,
        stored.unit,
        stored.eye,
        None,
        None,
        views,
        tuple(notes),
    )


def _notes(path: Path, stored: StoredSurface) -> Iterator[str]:
    """What of a file was not used, and why."""
    if stored.thinned_from:
        yield f"{path}: {len(stored.points):,} of its {stored.thinned_from:,} points were used, evenly spread."
    if is_far(stored.points) and np.array_equal(stored.points, stored.points.astype(np.float32)):
        step = float(np.spacing(np.float32(np.abs(stored.points).max())))
        yield (
            f"{path}: its coordinates are in single precision, so far from the origin in steps of {step:.2g}: subtract "
            "an offset where it is made."
        )
    left_out = [
        (stored.dropped, "coordinates that are no numbers"),
        (stored.at_origin, "exactly at (0, 0, 0), where programs put what was not measured"),
        (stored.stray, "too far away from all others"),
    ]
    if stored.repeated > _SOME * len(stored.points):
        left_out.append((stored.repeated, "others are at exactly the same place"))
    yield from (f"{path}: {count:,} of its points left out: {why}." for count, why in left_out if count)


def _of_result(path: Path, result: CleanedResult) -> ComparedSurface:
    cloud = result.cloud()
    effects = _effects(path, result)
    alone = len(result.stations) == 1 and result.whole.listing is None
    eye = result.stations[0].place.translation if alone else None
    noise = None
    if alone:
        scan = result.stations[0].scan
        if len(scan) == len(cloud.points) and scan.matches.sigma_px is not None:
            noise = _noise(scan, result.stations[0].place.rotation.T @ cloud.normals.T)
    points, normals = cloud.points, cloud.normals
    known: Bools = np.asarray(np.isfinite(points).all(axis=1))
    if not known.all():
        points, normals = points[known], normals[known]
        noise = None if noise is None else noise[known]
    views = tuple((station.place.translation, station.place @ station.scan.points) for station in result.stations)
    return ComparedSurface(str(path), points, normals, None, result.unit, eye, noise, effects, views)


def _noise(scan: FinishedScan, normals: Floats) -> Floats:
    """Standard deviations (N,) of a scan's points along normals (3, N) in its camera's frame, by its matches."""
    matches, calibration = scan.matches, scan.calibration

    def part(at: slice) -> Floats:
        numbers = np.arange(at.start, min(at.stop, len(matches)))
        covariance, along = point_covariances(matches[numbers], calibration), normals[:, numbers]
        return np.asarray(np.sqrt(np.einsum("in,nij,jn->n", along, covariance, along)))

    return np.concatenate(in_slices(len(matches), _AT_ONCE, part))


def _effects(path: Path, result: CleanedResult) -> CalibrationEffects | None:
    """Of the errors that all scans of a result share; None where they are not known."""
    if not result.stations:
        return None
    calibration = read_calibration_of(path)
    errors = rig_errors(calibration, read_uncertainty(path / CALIBRATION_FILE, calibration))
    if not errors.known:
        return None
    count = max(1, _EFFECTS // len(result.stations))
    parts = [_effects_of(errors, station.place, station.scan, count) for station in result.stations]
    return CalibrationEffects(np.concatenate([at for at, _ in parts]), np.concatenate([moved for _, moved in parts]))


def _effects_of(errors: SystematicErrors, place: Pose, scan: FinishedScan, count: int) -> tuple[Floats, Floats]:
    some = evenly_spread(np.arange(len(scan)), count)
    moved = place.rotation @ errors.of_points(scan.matches[some], scan.points[some])
    moved += place.translation[:, None] * errors.log_scale
    return place @ scan.points[some], moved


def are_on_both_sides(points: Floats, normals: Floats) -> bool:
    """Whether normals (N, 3) of points (N, 3) are on either side of the surface, told by some of them."""
    return are_opposed(evenly_spread(points, _OF_SIGNS), evenly_spread(normals, _OF_SIGNS))


def nearest_values(places: Floats, values: Floats, points: Floats) -> Floats:
    """Values (K,) at places (K, 3) for the nearest of which each of points (N, 3) is, (N,)."""
    chosen: Floats = values[np.asarray(cKDTree(places).query(points)[1])]
    return chosen


def mesh_of(path: Path, capture: int | None = None) -> tuple[Floats, Ints] | None:
    """Vertices and triangles of a surface in its own frame; None of a cloud without a mesh. Raises InputError."""
    if not path.is_dir():
        stored = read_surface(path)
        return None if stored.triangles is None else (stored.points, stored.triangles)
    try:
        mesh = mesh_in_axes(read_cleaned(path, capture))
    except InputError:  # its points do not hang together
        return None
    return mesh.points, mesh.triangles
