"""A result on a reference: aligned without a first guess, then the signed deviation of each point with its sigma."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from calib.numerics import Floats, Ints
from calib.registration import (
    Alignment,
    CellDeviations,
    Change,
    FreeSpace,
    Region,
    SurfacePoints,
    SurfaceRegistration,
    find_changes,
    from_samples,
    groups,
    register_surfaces,
    sample_surface,
)
from scanner.comparing.outer_sides import register_either_side, turned_note
from scanner.comparing.point_deviations import PointDeviations, box_diagonal, measure_deviations
from scanner.comparing.surfaces import NO_UNIT, ComparedSurface, read_compared
from scanner.errors import InputError
from scanner.quantities import METRES, UNKNOWN_UNIT, metres_per, parse_length, unit_name

_UNITS = ("mm", "m", "cm", "in", "um", "ft")  # that files without a unit may be in
_OFTEN = ("mm", "m")  # the same where neither file states one
_LEAST_RATIO, _MOST_RATIO = 0.15, 1.6  # plausible extents of a result, relative to the reference's
_SCALE_STEP, _SCALE_STEPS = 1.08, 6  # of a search for an unknown scale
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
    measured: PointDeviations | None
    """The result where the alignment puts it, with its deviations; None without an alignment."""
    reference: ComparedSurface
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
    def distance(self) -> Floats:
        """Signed deviations of the result's points, NaN where the reference has no surface, (N,); none without an
        alignment.
        """
        return np.zeros(0) if self.measured is None else self.measured.distance

    @property
    def compared(self) -> Floats:
        """Those of points that have a counterpart."""
        return self.distance[np.isfinite(self.distance)]

    @property
    def regions(self) -> tuple[Region, ...]:
        """That deviate by more than chance allows."""
        return () if self.measured is None else self.measured.regions


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
    if tolerance is not None:
        _tolerance(tolerance, stated or second.unit or NO_UNIT)  # what is none in any unit, before what takes seconds
    scales = _scales(first, second, stated, scale_free=scale_free)
    with_scale = scale_free or UNKNOWN_UNIT in (second.unit, first.unit)
    try:
        registration, turned = _registered(first, second, [scale for scale, _ in scales], with_scale=with_scale)
    except ValueError as error:
        raise InputError(f"{result} and {reference} cannot be aligned: {error}") from error
    except ImportError as error:
        raise InputError(str(error)) from error
    working, sentence = _unit_of(registration, scales, stated, first, second, with_scale=with_scale)
    limit = None if tolerance is None else _tolerance(tolerance, working)
    notes = [*second.notes, *first.notes]
    if turned is not None:
        notes.append(turned_note(*((first.name, second.name) if turned == 0 else (second.name, first.name))))
        first, second = (first.turned, second) if turned == 0 else (first, second.turned)
    names = (second.name, first.name)
    unaligned = SurfaceComparison(names, working, sentence, registration, None, first, None, None, False, tuple(notes))
    if registration.alignment is not Alignment.UNIQUE:
        return unaligned
    measured = measure_deviations(first, first.sampled, second, second.sampled, registration, limit)
    if turned is not None and not (first.knows_outside or second.knows_outside):
        measured = replace(measured, knows_outside=False)
    return replace(
        unaligned,
        measured=measured,
        changes=_changes(first, first.sampled, second, measured),
        test=None if limit is None else _test(measured.cells, limit, float(np.mean(~measured.there))),
        knows_calibration=second.effects is not None,
    )


def _registered(
    first: ComparedSurface, second: ComparedSurface, scales: Sequence[float], *, with_scale: bool
) -> tuple[SurfaceRegistration, int | None]:
    """The registration, and which of the surfaces had to be turned round for it.

    Files that do not state their units have the same one more often than not: where this gives one pose, no others
    are tried, at which a smaller surface would slide on a larger one.
    """
    known = first.knows_outside, second.knows_outside
    same = [scale for scale in scales if second.unit is None and not with_scale and scale == 1.0]
    for some in [same, scales] if same and len(scales) > 1 else [scales]:
        register = partial(register_surfaces, scales=some, with_scale=with_scale)
        registration, turned = register_either_side(
            first.sampled, second.sampled, register, known, is_only_mesh=first.is_mesh and not second.is_mesh
        )
        if registration.alignment is Alignment.UNIQUE:
            break
    return registration, turned


def _tolerance(text: str, unit: str) -> float:
    """A tolerance in the unit of the reference. Raises InputError."""
    try:
        return parse_length(text, unit)
    except InputError as error:
        hint = "; neither file states its unit: give the reference's, as in --unit mm" if unit == NO_UNIT else ""
        raise InputError(f"--tolerance: {error}{hint}") from error


def _scales(
    first: ComparedSurface, second: ComparedSurface, stated: str | None, *, scale_free: bool
) -> list[tuple[float, str | None]]:
    """Factors of the second one's lengths to try, each with the unit of the first one's, if that is open."""
    known = stated not in (None, UNKNOWN_UNIT) and second.has_length
    ratio = box_diagonal(first.points) / box_diagonal(second.points)
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
    registration: SurfaceRegistration,
    scales: list[tuple[float, str | None]],
    stated: str | None,
    first: ComparedSurface,
    second: ComparedSurface,
    *,
    with_scale: bool,
) -> tuple[str, str | None]:
    """The unit of the reference, and what was found out about it."""
    is_stated = stated is not None and stated != UNKNOWN_UNIT
    if registration.best is None:
        return str(stated) if is_stated else NO_UNIT, None
    scale = registration.best.scale
    enlarged = f"{second.name} was enlarged {scale:.6g} times, as fits best."
    if with_scale:
        return str(stated) if is_stated else NO_UNIT, enlarged
    if is_stated:
        own = min(METRES, key=lambda unit: abs(np.log(METRES[unit] / METRES[str(stated)] / scale)))
        is_other = second.unit is None and own != stated
        told = f"{second.name} does not state its unit: taken as '{own}', as fits best."
        return str(stated), told if is_other else None
    nearest = min(scales, key=lambda each: abs(np.log(each[0] / scale)))
    if nearest[1] is None:
        return str(second.unit or NO_UNIT), None if second.has_length or np.isclose(scale, 1.0) else enlarged
    return nearest[1], f"{first.name} does not state its unit: in {unit_name(nearest[1])} it fits."


def _changes(
    first: ComparedSurface, first_points: SurfacePoints, second: ComparedSurface, measured: PointDeviations
) -> tuple[Change, ...] | None:
    """What is new, gone or has moved, where both scanners' places are known."""
    registration = measured.registration
    if not (first.views and second.views) or registration.best is None:
        return None
    pose, scale, cells = registration.best.pose, registration.best.scale, measured.cells
    earlier = [FreeSpace.of(seen, eye) for eye, seen in first.views]
    later = [FreeSpace.of(pose @ (scale * seen), pose @ (scale * eye)) for eye, seen in second.views]
    former = sample_surface(first_points.points, first_points.normals, cells.cell, first_points.noise)
    now = sample_surface(measured.points, measured.normals, cells.cell, registration.residual)
    unmatched = ~from_samples(former.points, former.normals, now, np.zeros(len(now)), measured.reach).there
    gone, by = former.points[unmatched], _FREE_TOLERANCES * registration.tolerance
    return tuple(find_changes(cells, measured.regions, earlier, gone, later, by))


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
