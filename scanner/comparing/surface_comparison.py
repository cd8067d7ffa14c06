"""A result on a reference: aligned without a first guess, then the signed deviation of each point with its sigma."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from calib.numerics import Bools, Floats, Ints, evenly_spread
from calib.registration import (
    Alignment,
    CellDeviations,
    Change,
    Deviations,
    FreeSpace,
    Region,
    SurfacePoints,
    SurfaceRegistration,
    find_changes,
    find_regions,
    from_mesh,
    from_samples,
    groups,
    inflated,
    local_noise,
    register_surfaces,
    sample_surface,
)
from scanner.comparing.surfaces import ComparedSurface, nearest_values, read_compared
from scanner.errors import InputError
from scanner.quantities import METRES, UNKNOWN_UNIT, metres_per, parse_length, unit_name

_NO_UNIT = "units"
_UNITS = ("mm", "m", "cm", "in", "um", "ft")  # that files without a unit may be in
_OFTEN = ("mm", "m")  # the same where neither file states one
_LEAST_RATIO, _MOST_RATIO = 0.15, 1.6  # plausible extents of a result, relative to the reference's
_SCALE_STEP, _SCALE_STEPS = 1.08, 6  # of a search for an unknown scale
_CELLS, _SPACINGS, _REFERENCE_SPACINGS = 160.0, 3.0, 2.0
_REACH_TOLERANCES, _REACH_TOLERANCE = 20.0, 3.0  # of the alignment; of the one that was given
_SIDES = 6
_FREE_TOLERANCES = 3.0  # of the alignment, in front of what was seen, from which a point was in free space
_FAILS, _PASSES = 3.0, 2.0  # sigmas beyond, and within a tolerance
_FEWEST = 3  # adjoining cells
_UNMEASURED = 0.05  # share of the points without a counterpart that leaves a comparison undecided


class Conformity(Enum):
    """Whether a surface is within a tolerance."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "not decidable with this scan"


@dataclass(frozen=True, eq=False)
class ToleranceTest:
    """The outcome of a test against a tolerance."""

    tolerance: float
    conformity: Conformity
    beyond: float
    """Share of the compared area whose deviation is beyond it."""
    least_beyond: float
    """The same of what is surely beyond it."""
    most_beyond: float
    """The same of what may be beyond it."""
    failing: Ints
    """Numbers of the cells that are surely beyond it, in groups."""
    undecided: Ints
    """Numbers of the cells that may be, in groups."""


@dataclass(frozen=True, eq=False)
class SurfaceComparison:
    """A result on a reference. Lengths are in `unit`, and positions in the reference's frame."""

    names: tuple[str, str]
    unit: str
    found_unit: str | None
    """Of the file whose unit was found, as a sentence; None if none was."""
    registration: SurfaceRegistration
    points: Floats
    """(N, 3): the result's points where the alignment puts them; none without one."""
    normals: Floats
    """(N, 3)"""
    distance: Floats
    """(N,): signed deviations, NaN where the reference has no surface."""
    sigma: Floats
    """(N,): their standard deviations."""
    cells: CellDeviations | None
    regions: tuple[Region, ...]
    changes: tuple[Change, ...] | None
    """Of a later scan, the result, against an earlier one, the reference; None where it is not known from where either
    was taken."""
    test: ToleranceTest | None
    knows_calibration: bool
    """Whether the result's calibration is in the sigmas."""
    notes: tuple[str, ...]

    @property
    def is_aligned(self) -> bool:
        """Whether there is one pose, so that deviations mean something."""
        return self.registration.alignment is Alignment.UNIQUE

    @property
    def there(self) -> Bools:
        """Which points have a counterpart, (N,)."""
        return np.isfinite(self.distance)


def compare_surfaces(
    result: Path,
    reference: Path,
    *,
    unit: str | None = None,
    scale_free: bool = False,
    tolerance: str | None = None,
) -> SurfaceComparison:
    """Align a result with a reference, each a result folder, a cloud or a mesh, and compare.

    `unit`: of the reference, if its file does not say; `scale_free`: the scale is estimated. Raises InputError.
    """
    if unit is not None and unit not in METRES:
        raise InputError(f"--unit: expected one of {', '.join(METRES)}, found '{unit}'")
    second, first = read_compared(result), read_compared(reference)
    stated = unit or first.unit
    scales = _scales(first, second, stated, scale_free=scale_free)
    with_scale = scale_free or UNKNOWN_UNIT in (second.unit, first.unit)
    one, other = first.sampled(), second.sampled()
    try:
        found = register_surfaces(one, other, [scale for scale, _ in scales], with_scale=with_scale)
    except ValueError as error:
        raise InputError(f"{result} and {reference} cannot be aligned: {error}") from error
    except ImportError as error:
        raise InputError(str(error)) from error
    working, sentence = _unit_of(found, scales, stated, first, second, with_scale=with_scale)
    limit = None if tolerance is None else _tolerance(tolerance, working)
    notes = (*second.notes, *first.notes)
    names = (second.name, first.name)
    if found.alignment is not Alignment.UNIQUE or found.best is None:
        nothing = np.zeros((0, 3))
        return SurfaceComparison(
            names,
            working,
            sentence,
            found,
            nothing,
            nothing,
            nothing[:, 0],
            nothing[:, 0],
            None,
            (),
            None,
            None,
            False,
            notes,
        )
    pose, scale = found.best.pose, found.best.scale
    points = pose @ (scale * (second.points if not second.is_mesh else other.points))
    normals = other.normals if second.is_mesh else second.normals
    spacing = _spacing(points)
    are_oriented = normals is not None
    if normals is None:
        surface = sample_surface(points, None, _cell(points, spacing))
        normals = nearest_values(surface.points, surface.normals, points)
    else:
        normals = pose.rotate(normals)
    reach = _REACH_TOLERANCES * found.tolerance
    if limit is not None:
        reach = max(reach, _REACH_TOLERANCE * limit)
    deviations = _deviations(first, one, points, normals, reach, are_oriented=are_oriented)
    noise = _noise(second, points, scale)
    extra = None if second.effects is None else _calibration(second, found)
    cells, of_cell = _cells(found, points, normals, deviations, noise, extra, _cell(points, spacing))
    shared = np.sqrt(
        np.maximum(0.0, (cells.sigma[of_cell] / cells.inflation) ** 2 - cells_noise(of_cell, noise, len(cells.sigma)))
    )
    sigma = cells.inflation * np.sqrt(noise**2 + shared**2)
    regions = find_regions(cells)
    changes = _changes(first, one, second, found, cells, regions, points, normals, reach)
    test = None if limit is None else _test(cells, limit, float(np.mean(~deviations.there)))
    return SurfaceComparison(
        names,
        working,
        sentence,
        found,
        points,
        normals,
        deviations.distance,
        sigma,
        cells,
        tuple(regions),
        None if changes is None else tuple(changes),
        test,
        second.effects is not None,
        notes,
    )


def _tolerance(text: str, unit: str) -> float:
    """A tolerance in the unit of the reference. Raises InputError."""
    try:
        return parse_length(text, unit)
    except InputError as error:
        hint = "; neither file states its unit: give the reference's, as in --unit mm" if unit == _NO_UNIT else ""
        raise InputError(f"--tolerance: {error}{hint}") from error


def _scales(
    first: ComparedSurface, second: ComparedSurface, stated: str | None, *, scale_free: bool
) -> list[tuple[float, str | None]]:
    """Factors of the second one's lengths to try, each with the unit of the first one's, if that is open."""
    known = stated not in (None, UNKNOWN_UNIT) and second.has_length
    ratio = _extent(first.points) / _extent(second.points)
    if UNKNOWN_UNIT in (stated, second.unit) or (scale_free and not known):
        steps = range(-_SCALE_STEPS, _SCALE_STEPS + 1)
        return [(ratio * _SCALE_STEP**k, None) for k in steps]
    if known:
        return [(metres_per(str(second.unit)) / metres_per(str(stated)), None)]
    own = [str(second.unit)] if second.has_length else [*_UNITS]
    others = [stated] if stated is not None else [*_UNITS]
    if not second.has_length and stated is None:
        own, others = [*_OFTEN], [*_OFTEN]
    scales: dict[float, str | None] = {}
    for mine, theirs in product(own, others):
        scale = METRES[mine] / METRES[theirs]
        if _LEAST_RATIO * ratio < scale < _MOST_RATIO * ratio:
            scales.setdefault(round(scale, 12), theirs if second.has_length else None)
    if not scales:
        raise InputError(
            f"{first.name} and {second.name} are of very different sizes in every unit that was tried: give the "
            "reference's with --unit mm, or let the scale be found with --scale-free"
        )
    return list(scales.items())


def _unit_of(
    found: SurfaceRegistration,
    scales: list[tuple[float, str | None]],
    stated: str | None,
    first: ComparedSurface,
    second: ComparedSurface,
    *,
    with_scale: bool,
) -> tuple[str, str | None]:
    """The unit of the reference, and what was found out about it."""
    if stated is not None and stated != UNKNOWN_UNIT:
        if with_scale and found.best is not None:
            return stated, f"{second.name} was enlarged {found.best.scale:.6g} times, as fits best."
        return stated, None
    if found.best is None:
        return _NO_UNIT, None
    nearest = min(scales, key=lambda each: abs(np.log(each[0] / found.best.scale)))  # type: ignore[union-attr]
    if with_scale:
        return _NO_UNIT, f"{second.name} was enlarged {found.best.scale:.6g} times, as fits best."
    if nearest[1] is None:
        return str(second.unit or _NO_UNIT), None
    return nearest[1], f"{first.name} does not state its unit: in {unit_name(nearest[1])} it fits."


def _extent(points: Floats) -> float:
    low, high = np.quantile(evenly_spread(points, 20_000), (0.01, 0.99), axis=0)
    return max(float(np.linalg.norm(high - low)), 1e-300)


def _spacing(points: Floats) -> float:
    apart = cKDTree(points).query(evenly_spread(points, 3000), 4)[0]
    return float(np.median(np.asarray(apart)[:, -1])) / 1.5


def _cell(points: Floats, spacing: float) -> float:
    return max(_extent(points) / _CELLS, _SPACINGS * spacing)


def _noise(second: ComparedSurface, points: Floats, scale: float) -> Floats:
    """Standard deviations (N,) of the points along their normals."""
    if second.noise is not None:
        return scale * second.noise
    return np.zeros(len(points)) if second.is_mesh else local_noise(points, points)


def _deviations(
    first: ComparedSurface, one: SurfacePoints, points: Floats, normals: Floats, reach: float, *, are_oriented: bool
) -> Deviations:
    if first.triangles is not None:
        return from_mesh(points, normals, first.points, first.triangles, reach)
    cell = max(_extent(one.points) / _CELLS, _REFERENCE_SPACINGS * _spacing(one.points))
    samples = sample_surface(one.points, one.normals, cell, one.noise).on_surface()
    noise = local_noise(one.points, samples.points)
    return from_samples(points, normals, samples, noise, reach, are_oriented=are_oriented)


def _changes(
    first: ComparedSurface,
    one: SurfacePoints,
    second: ComparedSurface,
    found: SurfaceRegistration,
    cells: CellDeviations,
    regions: Sequence[Region],
    points: Floats,
    normals: Floats,
    reach: float,
) -> list[Change] | None:
    """What is new, gone or has moved, where both scanners' places are known."""
    if not (first.views and second.views) or found.best is None:
        return None
    pose, scale = found.best.pose, found.best.scale
    earlier = [FreeSpace.of(seen, eye) for eye, seen in first.views]
    later = [FreeSpace.of(pose @ (scale * seen), pose @ (scale * eye)) for eye, seen in second.views]
    former = sample_surface(one.points, one.normals, cells.cell, one.noise)
    now = sample_surface(points, normals, cells.cell, found.residual)
    unmatched = ~from_samples(former.points, former.normals, now, np.zeros(len(now)), reach).there
    return find_changes(cells, regions, earlier, former.points[unmatched], later, _FREE_TOLERANCES * found.tolerance)


def _calibration(second: ComparedSurface, found: SurfaceRegistration) -> tuple[Floats, Floats] | None:
    """Places (K, 3), and the effects (K, 3, S) of the calibration's errors there, after the alignment."""
    if second.effects is None or found.best is None:
        return None
    pose, scale = found.best.pose, found.best.scale
    return pose @ (scale * second.effects.points), scale * (pose.rotation @ second.effects.moved)


def _cells(
    found: SurfaceRegistration,
    points: Floats,
    normals: Floats,
    deviations: Deviations,
    noise: Floats,
    calibration: tuple[Floats, Floats] | None,
    cell: float,
) -> tuple[CellDeviations, Ints]:
    """Means over cells, and the cell of each point, (N,): both sides of something thin are in different ones."""
    place = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    axis = np.argmax(np.abs(normals), axis=1)
    side = 2 * axis + (normals[np.arange(len(normals)), axis] > 0)
    number = ((place[:, 0] << 21 | place[:, 1]) << 21 | place[:, 2]) * _SIDES + side
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
    variance += found.position_covariance(facing, middle)
    if calibration is not None:
        variance += _calibration_variance(found, middle, facing, *calibration)
    least = 1e-9 * cell
    sigma, factor = inflated(np.sqrt(np.maximum(variance, least**2)), distance)
    return CellDeviations(middle, facing, distance, sigma, cell, factor), of_cell


def _calibration_variance(
    found: SurfaceRegistration, points: Floats, normals: Floats, places: Floats, moved: Floats
) -> Floats:
    """Variance (C,) along normals (C, 3) by the calibration, without what the alignment takes up."""
    own = nearest_values(points, normals, places)
    effects = np.einsum("ki,kis->ks", own, moved)
    jacobian = found.jacobian(own, places)
    effects -= jacobian @ np.linalg.lstsq(jacobian, effects, rcond=1e-9)[0]
    return nearest_values(places, np.sum(effects**2, axis=1), points)


def cells_noise(of_cell: Ints, noise: Floats, count: int) -> Floats:
    """The variance of the means (C,) by the points' own noise, for each point: (N,)."""
    points = np.bincount(of_cell, minlength=count)
    variance: Floats = (np.bincount(of_cell, noise**2, count) / np.maximum(points, 1) ** 2)[of_cell]
    return variance


def _test(cells: CellDeviations, tolerance: float, unmeasured: float) -> ToleranceTest:
    there = np.isfinite(cells.distance)
    size = np.abs(np.where(there, cells.distance, 0.0))
    surely = there & (size - _FAILS * cells.sigma > tolerance)
    maybe = there & (size + _PASSES * cells.sigma > tolerance)
    failing = [each for each in groups(cells.points, surely, cells.cell) if len(each) >= _FEWEST]
    undecided = [each for each in groups(cells.points, maybe, cells.cell) if len(each) >= _FEWEST]
    if failing:
        conformity = Conformity.FAIL
    elif undecided or unmeasured > _UNMEASURED:
        conformity = Conformity.UNDECIDED
    else:
        conformity = Conformity.PASS
    compared = max(1, int(np.count_nonzero(there)))
    none = np.zeros(0, np.int64)
    return ToleranceTest(
        tolerance,
        conformity,
        float(np.count_nonzero(there & (size > tolerance))) / compared,
        float(np.count_nonzero(there & (size - _PASSES * cells.sigma > tolerance))) / compared,
        float(np.count_nonzero(maybe)) / compared,
        np.concatenate(failing) if failing else none,
        np.concatenate(undecided) if undecided else none,
    )
