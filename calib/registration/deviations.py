"""Signed distances of a surface from a reference, after registration: of every point, of cells of points, of regions
that differ by more than chance allows; and what has changed between two scans of one place.

A point is new if the earlier scanner looked through the place where it is, and gone if the later one did. What neither
saw through may have been there, or may still be: what is hidden has not changed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from calib.deferred_imports import open3d
from calib.numerics import Bools, Floats, Ints, in_slices, robust_sigma
from calib.registration.sampled_surface import SampledSurface, pair_samples
from calib.registration.surface_pair import FreeSpace

_BESIDE = 1.5  # cells of the reference along its surface, beyond which it has no surface
_LIKE = 0.5  # least cosine of both normals
_LIKE_SAMPLES, _OF_BEND = (
    0.9,
    0.25,
)  # the same of samples; share of the distance aside times their angle that is a sigma
_OF_CELL = 0.01  # share of a cell by which its plane may be off, whatever the noise
_FACING = 0.85  # least cosine of the way to the nearest point of a mesh and its normal: less beyond an edge of the mesh
_AT_ONCE = 200_000
# Sigmas of all cells of a region, of at least `_FEWEST` of them, and of at least `_SEEDS`.
_EDGE, _SIGNIFICANT, _SEED_SIGMAS = 1.5, 4.0, 5.5
_FEWEST, _SEEDS = 6, 2
_LEAST = ((_SIGNIFICANT, _FEWEST), (_SEED_SIGMAS, _SEEDS))
_AROUND = 1.75  # cells, between neighbours
_PEAK_CELLS = 9


@dataclass(frozen=True, eq=False)
class Deviations:
    """Of points from a reference."""

    distance: Floats
    """(N,): along the surface's outward normal; NaN where the reference has no surface."""
    variance: Floats
    """(N,): of the reference."""

    @property
    def there(self) -> Bools:
        """Which points have a counterpart, (N,)."""
        return np.isfinite(self.distance)


def from_samples(
    points: Floats,
    normals: Floats,
    reference: SampledSurface,
    noise: Floats,
    reach: float,
    *,
    are_oriented: bool = True,
) -> Deviations:
    """Of points (N, 3) with normals (N, 3) from the S samples of a cloud, up to a distance `reach`.

    `noise` (S,): standard deviation of a point around each sample.
    `are_oriented`: whether the normals say which side is outside; otherwise the reference does.
    """
    tree, beside = scipy.spatial.cKDTree(reference.points), _BESIDE * reference.cell

    def part(at: slice) -> tuple[Floats, Floats]:
        pairs = pair_samples(
            reference,
            tree,
            points[at],
            normals[at],
            float(np.hypot(reach, beside)),
            turn_points=not are_oriented,
            turn_samples=are_oriented and not reference.is_oriented,
        )
        near = np.isfinite(pairs.apart) & (pairs.aside < beside) & (np.abs(pairs.along) < reach)
        variance = noise[pairs.nearest] ** 2 / np.maximum(reference.count[pairs.nearest], 1)
        # Between planes that are not quite parallel, as beside a crease, the distance depends on where it is measured.
        variance += (_OF_BEND * pairs.aside) ** 2 * np.maximum(0.0, 2 - 2 * pairs.cosine)
        variance += (_OF_CELL * reference.cell) ** 2
        return np.where(near & (pairs.cosine > _LIKE_SAMPLES), pairs.along, np.nan), variance

    parts = in_slices(len(points), _AT_ONCE, part)
    return Deviations(np.concatenate([each for each, _ in parts]), np.concatenate([each for _, each in parts]))


def from_mesh(points: Floats, normals: Floats, vertices: Floats, triangles: Ints, reach: float) -> Deviations:
    """Of points (N, 3) with normals (N, 3) from a mesh, whatever way its triangles face.

    Raises ImportError where Open3D is missing.
    """
    o3d = open3d()
    middle = vertices.mean(axis=0)  # single precision
    scene = o3d.t.geometry.RaycastingScene()
    corners = o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32))
    scene.add_triangles(o3d.core.Tensor(np.ascontiguousarray(vertices - middle, np.float32)), corners)
    distances = []
    for start in range(0, len(points), _AT_ONCE):
        some, facing = points[start : start + _AT_ONCE] - middle, normals[start : start + _AT_ONCE]
        nearest = scene.compute_closest_points(o3d.core.Tensor(some.astype(np.float32)))
        off = some - nearest["points"].numpy().astype(np.float64)
        face = nearest["primitive_normals"].numpy().astype(np.float64)
        length = np.linalg.norm(off, axis=1)
        along = np.sum(off * face, axis=1)
        is_beyond_edge = (np.abs(along) < _FACING * length) & (length > 1e-3 * reach)
        cosine = np.sum(face * facing, axis=1)
        signed = np.where(cosine < 0, -1.0, 1.0) * along
        # Beside an edge between faces the nearest point is on it, and the way to it between both normals.
        on_edge = is_beyond_edge & (np.abs(np.sum(off * facing, axis=1)) > _FACING * length)
        signed = np.where(on_edge, np.sign(np.sum(off * facing, axis=1)) * length, signed)
        near = (length < reach) & (~is_beyond_edge | on_edge) & (on_edge | (np.abs(cosine) > _LIKE))
        distances.append(np.where(near, signed, np.nan))
    return Deviations(np.concatenate(distances), np.zeros(len(points)))


@dataclass(frozen=True, eq=False)
class CellDeviations:
    """Mean deviations of the points of each cell of a surface."""

    points: Floats
    """(C, 3)"""
    normals: Floats
    """(C, 3)"""
    distance: Floats
    """(C,); NaN without a counterpart."""
    sigma: Floats
    """(C,): standard deviation of the mean, with what alignment and calibration add."""
    cell: float
    """Edge of a cell."""
    inflation: float
    """By how much the sigmas were enlarged to fit what cells differ by."""

    @property
    def area(self) -> float:
        """Of a cell."""
        return self.cell**2


@dataclass(frozen=True, eq=False)
class Region:
    """Adjoining cells that deviate to the same side by more than chance allows."""

    centre: Floats
    """(3,)"""
    direction: Floats
    """(3,): mean outward normal."""
    size: float
    """Largest distance within it."""
    area: float
    volume: float
    """Between both surfaces, negative where something is missing."""
    peak: float
    """Of the deviation: a mean of a few cells around the largest."""
    sigma: float
    """Of the peak."""
    cells: Ints
    """Numbers of the cells."""


def inflated(sigma: Floats, distance: Floats) -> tuple[Floats, float]:
    """Sigmas (C,) that are no smaller than what the middle of the distances (C,) scatters by, and the factor."""
    there = np.isfinite(distance)
    factor = max(1.0, robust_sigma(distance[there] / sigma[there])) if there.any() else 1.0
    return factor * sigma, factor


def find_regions(cells: CellDeviations) -> list[Region]:
    """Regions of a surface that deviate, the largest area first."""
    with np.errstate(invalid="ignore"):
        z = cells.distance / cells.sigma
    return sorted(_regions(cells, z), key=lambda region: -region.area)


def groups(points: Floats, chosen: Bools, cell: float) -> list[Ints]:
    """Adjoining ones (numbers) of cells at points (C, 3) that are chosen (C,)."""
    numbers = np.flatnonzero(chosen)
    if not len(numbers):
        return []
    pairs = scipy.spatial.cKDTree(points[numbers]).query_pairs(_AROUND * cell, output_type="ndarray")
    shape = (len(numbers), len(numbers))
    joined = scipy.sparse.coo_matrix((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape)
    label = scipy.sparse.csgraph.connected_components(joined, directed=False)[1]
    order = np.argsort(label, kind="stable")
    return np.split(numbers[order], np.flatnonzero(np.diff(label[order])) + 1)


def _regions(cells: CellDeviations, z: Floats) -> Iterator[Region]:
    for side in (1.0, -1.0):
        for numbers in groups(cells.points, side * np.nan_to_num(z) > _EDGE, cells.cell):
            if any(np.count_nonzero(side * z[numbers] > least) < count for least, count in _LEAST):
                continue
            own, points = cells.distance[numbers], cells.points[numbers]
            largest = points[np.argmax(side * _smoothed(points, own, cells.cell))]
            around = np.argsort(np.linalg.norm(points - largest, axis=1), kind="stable")[:_PEAK_CELLS]
            sigma = float(np.mean(cells.sigma[numbers][around]))
            normal = cells.normals[numbers].mean(axis=0)
            yield Region(
                points.mean(axis=0),
                normal / max(float(np.linalg.norm(normal)), 1e-12),
                2 * float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()) + cells.cell,
                len(numbers) * cells.area,
                float(np.sum(own)) * cells.area,
                float(np.mean(own[around])),
                sigma,
                numbers,
            )


def _smoothed(points: Floats, values: Floats, cell: float) -> Floats:
    """Means of values (N,) over the cells around each, (N,)."""
    near = scipy.spatial.cKDTree(points).query_ball_point(points, _AROUND * cell)
    return np.array([values[each].mean() for each in near])


_ONE_CHANGE = 2.5  # cells, of which parts of one change count as adjoining


@dataclass(frozen=True, eq=False)
class Change:
    """Something that changed: parts near each other that deviate, are new or gone."""

    centre: Floats
    """(3,)"""
    size: float
    """Largest distance within it."""
    deviating: float
    """Area that deviates by more than chance."""
    new: float
    """Area where there was free space."""
    gone: float
    """Area where there is free space now."""
    peak: float
    """The largest deviation; 0 if nothing deviates."""
    sigma: float
    """Of the peak."""


def unseen_through(points: Floats, spaces: Sequence[FreeSpace], by: float) -> Bools:
    """Which points (N, 3) none of the scanners looked through, (N,)."""
    through = np.zeros(len(points), np.bool_)
    for space in spaces:
        through |= space.is_violated(points, by)
    return ~through


def find_changes(
    cells: CellDeviations,
    regions: Sequence[Region],
    earlier: Sequence[FreeSpace],
    former: Floats,
    later: Sequence[FreeSpace],
    margin: float,
) -> list[Change]:
    """Changes from an earlier scan to a later one, the largest first.

    `cells`: of the later one, with its deviating `regions`; `former` (F, 3): cells of the earlier one that have no
    counterpart. A point is in free space if it is in front of what was seen by more than a `margin`.
    """
    missing = np.flatnonzero(~np.isfinite(cells.distance))
    new = missing[~unseen_through(cells.points[missing], earlier, margin)]
    gone = former[~unseen_through(former, later, margin)]
    parts = [cells.points[region.cells] for region in regions]
    kinds = [0] * len(parts)
    for number, points in ((1, cells.points[new]), (2, gone)):
        for numbers in groups(points, np.ones(len(points), np.bool_), cells.cell):
            if len(numbers) >= _FEWEST:
                parts.append(points[numbers])
                kinds.append(number)
    if not parts:
        return []
    whole = np.concatenate(parts)
    part = np.repeat(np.arange(len(parts)), [len(each) for each in parts])
    kind: Ints = np.array(kinds, np.int64)[part]
    near = groups(whole, np.ones(len(whole), np.bool_), _ONE_CHANGE * cells.cell)
    changes = [_change(numbers, whole, part, kind, regions, cells) for numbers in near]
    return sorted(changes, key=lambda change: -(change.deviating + change.new + change.gone))


def _change(
    numbers: Ints, whole: Floats, part: Ints, kind: Ints, regions: Sequence[Region], cells: CellDeviations
) -> Change:
    points = whole[numbers]
    deviating, new, gone = (float(np.count_nonzero(kind[numbers] == k)) * cells.area for k in range(3))
    own = [regions[k] for k in np.unique(part[numbers]) if k < len(regions)]
    largest = max(own, key=lambda region: abs(region.peak), default=None)
    centre = points.mean(axis=0)
    size = 2 * float(np.linalg.norm(points - centre, axis=1).max()) + cells.cell
    peak, sigma = (largest.peak, largest.sigma) if largest is not None else (0.0, 0.0)
    return Change(centre, size, deviating, new, gone, peak, sigma)
