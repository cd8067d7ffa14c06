"""Signed deviations of a surface's points from an aligned reference, with their sigmas, by points and by cells."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from calib.numerics import Bools, Floats, Ints, evenly_spread
from calib.registration import (
    CellDeviations,
    Deviations,
    Region,
    SampledSurface,
    SurfacePoints,
    SurfaceRegistration,
    cell_numbers,
    extent_of,
    find_regions,
    from_mesh,
    from_samples,
    inflated,
    local_noise,
    sample_surface,
    spacing_of,
)
from scanner.comparing.outer_sides import outer_normals, towards
from scanner.comparing.surfaces import ComparedSurface, are_on_both_sides, nearest_values

_CELLS, _SPACINGS, _REFERENCE_SPACINGS = 160.0, 3.0, 2.0
_REACH_TOLERANCES, _REACH_TOLERANCE = 20.0, 3.0  # of the alignment; of the one that was given
_SIDES = 6
_BESIDE = 1.5  # cells, up to which a point of the reference is near a cell that was compared
_SAMPLE, _OUTSIDE = 20_000, 0.01  # points that tell the extent; share of them outside of it at either end


@dataclass(frozen=True, eq=False)
class PointDeviations:
    """Deviations of an aligned surface, in the reference's frame and unit."""

    registration: SurfaceRegistration
    points: Floats
    """(N, 3): where the alignment puts them."""
    normals: Floats
    """(N, 3)"""
    distance: Floats
    """(N,); NaN where the reference has no surface."""
    sigma: Floats
    """(N,): standard deviations."""
    cells: CellDeviations
    of_cell: Ints
    """(N,): the number of each point's cell."""
    regions: tuple[Region, ...]
    """That deviate by more than chance allows."""
    reach: float
    """Largest deviation."""
    knows_outside: bool
    """Whether the signs are certain: one of the two says which side of the surface is outside."""

    @property
    def there(self) -> Bools:
        """Which points have a counterpart, (N,)."""
        return np.isfinite(self.distance)

    def on_reference(self, points: Floats) -> tuple[Floats, Floats]:
        """Mean deviations of what is nearest to points (N, 3) of the reference, and their sigmas, (N,); NaN where
        nothing was compared.
        """
        cells = self.cells
        compared = np.flatnonzero(np.isfinite(cells.distance))
        if not len(compared):
            return np.full(len(points), np.nan), np.full(len(points), np.nan)
        distance, sigma = cells.distance[compared], cells.sigma[compared]
        feet = cells.points[compared] - distance[:, None] * cells.normals[compared]
        apart, nearest = cKDTree(feet).query(points, distance_upper_bound=_BESIDE * cells.cell)
        near = np.isfinite(apart)
        nearest = np.where(near, nearest, 0)
        return np.where(near, distance[nearest], np.nan), np.where(near, sigma[nearest], np.nan)


def measure_deviations(
    first: ComparedSurface,
    first_points: SurfacePoints,
    second: ComparedSurface,
    second_points: SurfacePoints,
    registration: SurfaceRegistration,
    limit: float | None,
) -> PointDeviations:
    """Deviations of the `second` surface from the `first` one, given the points of both that were registered.

    `limit`: a tolerance that is to be tested.
    """
    assert registration.best is not None
    pose, scale = registration.best.pose, registration.best.scale
    points = pose @ (scale * (second.points if not second.is_mesh else second_points.points))
    normals = _normals_of_mesh(second_points) if second.is_mesh else second.normals
    spacing = spacing_of(points)
    reference = _reference(first_points)
    are_oriented = True
    if normals is None:
        eye = None if second.eye is None else pose @ (scale * second.eye)
        of_mesh = reference if first.is_mesh and reference.is_oriented else None
        normals, are_oriented = outer_normals(points, _cell(points, spacing), eye, of_mesh)
    else:
        normals = pose.rotate(normals)
    reach = _REACH_TOLERANCES * registration.tolerance
    if limit is not None:
        reach = max(reach, _REACH_TOLERANCE * limit)
    if first.triangles is not None:
        deviations = from_mesh(points, normals, first.points, first.triangles, reach)
    else:
        samples = reference.on_surface()
        spread = local_noise(first_points.points, samples.points)
        deviations = from_samples(points, normals, samples, spread, reach, are_oriented=are_oriented)
    noise = _noise(second, points, scale)
    extra = None if second.effects is None else _calibration(second, registration)
    cells, of_cell = _cells(registration, points, normals, deviations, noise, extra, _cell(points, spacing))
    shared = np.sqrt(
        np.maximum(0.0, (cells.sigma[of_cell] / cells.inflation) ** 2 - _of_means(of_cell, noise, len(cells.sigma)))
    )
    sigma = cells.inflation * np.sqrt(noise**2 + shared**2)
    regions = tuple(find_regions(cells))
    known = are_oriented or reference.is_oriented
    return PointDeviations(
        registration, points, normals, deviations.distance, sigma, cells, of_cell, regions, reach, known
    )


def box_diagonal(points: Floats) -> float:
    """The diagonal of what holds nearly all points (N, 3); never 0."""
    return max(extent_of(evenly_spread(points, _SAMPLE), _OUTSIDE), 1e-300)


def _cell(points: Floats, spacing: float) -> float:
    return max(box_diagonal(points) / _CELLS, _SPACINGS * spacing)


def _noise(second: ComparedSurface, points: Floats, scale: float) -> Floats:
    """Standard deviations (N,) of the points along their normals."""
    if second.noise is not None:
        return scale * second.noise
    return np.zeros(len(points)) if second.is_mesh else local_noise(points, points)


def _normals_of_mesh(sampled: SurfacePoints) -> Floats | None:
    """Of its samples, if its faces are all on one side."""
    normals = sampled.normals
    return None if normals is None or are_on_both_sides(sampled.points, normals) else normals


def _reference(surface: SurfacePoints) -> SampledSurface:
    """Samples of the first surface, with normals on the outer side if it is known."""
    cell = max(box_diagonal(surface.points) / _CELLS, _REFERENCE_SPACINGS * spacing_of(surface.points))
    samples = sample_surface(surface.points, surface.normals, cell, surface.noise)
    if samples.is_oriented or surface.eye is None:
        return samples
    return replace(samples, normals=towards(samples.normals, samples.points, surface.eye), is_oriented=True)


def _calibration(second: ComparedSurface, registration: SurfaceRegistration) -> tuple[Floats, Floats] | None:
    """Places (K, 3), and the effects (K, 3, S) of the calibration's errors there, after the alignment."""
    if second.effects is None or registration.best is None:
        return None
    pose, scale = registration.best.pose, registration.best.scale
    return pose @ (scale * second.effects.points), scale * (pose.rotation @ second.effects.moved)


def _cells(
    registration: SurfaceRegistration,
    points: Floats,
    normals: Floats,
    deviations: Deviations,
    noise: Floats,
    calibration: tuple[Floats, Floats] | None,
    cell: float,
) -> tuple[CellDeviations, Ints]:
    """Means over cells, and the cell of each point, (N,): both sides of something thin are in different ones."""
    axis = np.argmax(np.abs(normals), axis=1)
    side = 2 * axis + (normals[np.arange(len(normals)), axis] > 0)
    number = cell_numbers(points, cell, points.min(axis=0)) * _SIDES + side
    of_cell = np.unique(number, return_inverse=True)[1].reshape(-1).astype(np.int64)
    count = np.bincount(of_cell)

    def mean(values: Floats) -> Floats:
        return np.stack([np.bincount(of_cell, column) for column in values.T], axis=1) / count[:, None]

    there = deviations.there
    with_counterpart = np.bincount(of_cell[there], minlength=len(count))
    total = np.bincount(of_cell[there], deviations.distance[there], len(count))
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.where(2 * with_counterpart >= count, total / with_counterpart, np.nan)
    middle, facing = mean(points), mean(normals)
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-9)
    variance = np.bincount(of_cell, noise**2) / count**2
    variance += np.bincount(of_cell, deviations.variance) / count
    variance += registration.position_covariance(facing, middle)
    if calibration is not None:
        variance += _calibration_variance(registration, middle, facing, *calibration)
    least = 1e-9 * cell
    sigma, factor = inflated(np.sqrt(np.maximum(variance, least**2)), distance)
    return CellDeviations(middle, facing, distance, sigma, cell, factor), of_cell


def _calibration_variance(
    registration: SurfaceRegistration, points: Floats, normals: Floats, places: Floats, moved: Floats
) -> Floats:
    """Variance (C,) along normals (C, 3) by the calibration, without what the alignment takes up."""
    own = nearest_values(points, normals, places)
    effects = np.einsum("ki,kis->ks", own, moved)
    jacobian = registration.jacobian(own, places)
    effects -= jacobian @ np.linalg.lstsq(jacobian, effects, rcond=1e-9)[0]
    return nearest_values(places, np.sum(effects**2, axis=1), points)


def _of_means(of_cell: Ints, noise: Floats, count: int) -> Floats:
    """The variance of the means (C,) by the points' own noise, for each point: (N,)."""
    points = np.bincount(of_cell, minlength=count)
    variance: Floats = (np.bincount(of_cell, noise**2, count) / np.maximum(points, 1) ** 2)[of_cell]
    return variance
