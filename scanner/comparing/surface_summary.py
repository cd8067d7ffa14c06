"""A comparison of surfaces in words and as tables."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from rich.table import Table

from calib.numerics import Floats
from calib.registration import Alignment, Change, FreeMotion, Region, SurfacePose
from scanner.comparing.surface_comparison import Conformity, SurfaceComparison
from scanner.quantities import ShownUnit, empty_table, plain, shown_unit
from scanner.results import Verdict

QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
_MOST_REGIONS, _MOST_ALTERNATIVES = 10, 5
_ADVICE = {
    Alignment.AMBIGUOUS: "Scan more of it, so that what tells the poses apart is seen, or give a larger reference.",
    Alignment.LOOSE: "Scan more of it, or something beside it that holds it.",
    Alignment.NONE: "Check that both are of the same thing, and the units (--unit); let both show more in common.",
}


def surface_verdict(comparison: SurfaceComparison) -> Verdict:
    """Whether the alignment is certain, and whether the surface is within the tolerance."""
    registration = comparison.registration
    match registration.alignment:
        case Alignment.AMBIGUOUS:
            count = 1 + len(registration.alternatives)
            if any(pose.is_mirrored for pose in registration.alternatives):
                headline = (
                    "The alignment is ambiguous: only walls or flat faces coincide, and the mirror image fits as well."
                )
            else:
                headline = f"The alignment is ambiguous: {count} poses fit equally well, so no deviation is certain."
        case Alignment.LOOSE:
            headline = "The alignment is not determined, so no deviation is certain."
        case Alignment.NONE:
            headline = "The surfaces do not fit together anywhere, so nothing can be compared."
        case Alignment.UNIQUE:
            return _verdict_of_surface(comparison)
    return Verdict("refused", headline, tuple(_alignment_reasons(comparison)), _ADVICE[registration.alignment])


def _verdict_of_surface(comparison: SurfaceComparison) -> Verdict:
    reasons, unit = tuple(_reasons(comparison)), shown_unit(comparison.unit)
    test = comparison.test
    if not len(comparison.compared):
        return Verdict("refused", "No point has a counterpart in the reference, so nothing is compared.", reasons)
    if test is None:
        if comparison.regions:
            count = len(comparison.regions)
            where = "in one region" if count == 1 else f"in {count} regions"
            return Verdict("fair", f"The surface deviates {where} by more than its sigmas allow.", reasons)
        if comparison.changes:
            return Verdict("fair", "Nothing deviates, but something is new or gone.", reasons)
        return Verdict("good", "No region deviates by more than its sigmas allow.", reasons)
    limit = unit.stated(test.tolerance)
    if test.conformity is Conformity.PASS:
        return Verdict("good", f"Pass: the compared surface is within {limit}.", reasons)
    if test.conformity is Conformity.FAIL:
        return Verdict("refused", f"Fail: a part of the surface is surely beyond {limit}.", reasons)
    advice = "Scan it from nearer, or more of it; or test against a larger tolerance."
    return Verdict("fair", f"Not decidable with this scan: a part may be beyond {limit}.", reasons, advice)


def _alignment_reasons(comparison: SurfaceComparison) -> Iterator[str]:
    registration, unit = comparison.registration, shown_unit(comparison.unit)
    for motion in registration.free:
        yield _free_motion(motion, unit)
    if registration.alternatives and registration.best is not None:
        for number, pose in enumerate(registration.alternatives[:_MOST_ALTERNATIVES], start=1):
            yield f"Alternative {number}: {_against(registration.best, pose, registration.centre, unit)}."
        if more := registration.alternatives[_MOST_ALTERNATIVES:]:
            yield f"{len(more)} more."
    if registration.alignment is Alignment.NONE and registration.best is not None:
        best = registration.best
        yield (
            f"Where they fit best, {100 * best.share:.0f} % of what could coincide does, and "
            f"{100 * best.overlap[1]:.0f} % of {comparison.names[0]} coincides."
        )


def _free_motion(motion: FreeMotion, unit: ShownUnit) -> str:
    direction = ", ".join(f"{value:.2f}" for value in motion.direction)
    if not motion.turns:
        return f"It may slide along ({direction})."
    through = ", ".join(unit.number(float(value)) for value in motion.through)
    return f"It may turn about the axis ({direction}) through ({through}) {unit.name}."


def _against(best: SurfacePose, pose: SurfacePose, centre: Floats, unit: ShownUnit) -> str:
    turn = float(np.degrees(best.pose.angle_from(pose.pose)))
    shift = pose.pose @ best.pose.undo(centre) - centre if best.scale == pose.scale else np.zeros(3)
    moved = unit.error(float(np.linalg.norm(shift)))
    if pose.is_mirrored:
        return f"the mirror image, of which {100 * pose.overlap[1]:.0f} % coincides"
    scaled = "" if np.isclose(best.scale, pose.scale) else f", and {pose.scale / best.scale:.4g} times as large"
    return f"turned by {turn:.1f}° and shifted by {moved}{scaled}"


def _reasons(comparison: SurfaceComparison) -> Iterator[str]:
    unit, registration = shown_unit(comparison.unit), comparison.registration
    if comparison.found_unit:
        yield comparison.found_unit
    assert registration.best is not None
    overlap, sigma = registration.best.overlap, np.sqrt(np.diag(registration.covariance))
    shift, turn_deg = float(np.linalg.norm(sigma[3:6])), float(np.degrees(np.linalg.norm(sigma[:3])))
    yield (
        f"Aligned on {100 * overlap[1]:.0f} % of {comparison.names[0]} and {100 * overlap[0]:.0f} % of "
        f"{comparison.names[1]}, to ± {unit.error(shift)} and ± {plain(turn_deg, 4)}°."
    )
    distance = comparison.compared
    if len(distance):
        low, middle, high = np.quantile(distance, (0.05, 0.5, 0.95))
        shown = partial(unit.number, signed=True, beside=float(high - low))
        yield (
            f"90 % of {len(distance):,} points deviate by {shown(float(low))} to {shown(float(high))} {unit.name}, "
            f"median {shown(float(middle))} {unit.name}."
        )
    missing = 1 - len(distance) / max(1, len(comparison.distance))
    if missing > 0.005:
        yield f"{100 * missing:.1f} % of the points have no counterpart in the reference."
    test = comparison.test
    if test is not None:
        yield (
            f"{_percent(test.beyond)} of the compared area deviates by more than {unit.stated(test.tolerance)}: "
            f"surely {_percent(test.least_beyond)}, at most {_percent(test.most_beyond)}."
        )
    for region in comparison.regions[:_MOST_REGIONS]:
        yield f"Region: {region_text(region, unit)}."
    for change in (comparison.changes or ())[:_MOST_REGIONS]:
        if change.new or change.gone:
            yield f"Changed: {change_text(change, unit)}."
    inflation = 1.0 if comparison.measured is None else comparison.measured.cells.inflation
    if inflation > 1.3:
        yield (
            f"Deviations scatter {inflation:.1f} times as much as the noise explains, so sigmas were enlarged to that."
        )
    if comparison.measured is not None and not comparison.measured.knows_outside:
        yield "Neither says for certain which side is outside: the signs of all deviations may be the reverse."
    if not comparison.knows_calibration:
        yield f"What the calibration of {comparison.names[0]} adds is not in the sigmas: it is not known."


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def region_text(region: Region, unit: ShownUnit) -> str:
    """Depth or height with sigma, size and place of a region."""
    centre = ", ".join(unit.number(float(value)) for value in region.centre)
    kind = "out" if region.peak > 0 else "in"
    return (
        f"{unit.measured(abs(region.peak), region.sigma)} {unit.name} {kind}, {unit.error(region.size)} across, at "
        f"({centre}) {unit.name}"
    )


def change_text(change: Change, unit: ShownUnit) -> str:
    """What a change is, its size and place."""
    centre = ", ".join(unit.number(float(value)) for value in change.centre)
    kinds = [
        f"deviates by {unit.measured(change.peak, change.sigma)} {unit.name}" if change.deviating else "",
        "new where there was free space" if change.new else "",
        "gone, where there is free space now" if change.gone else "",
    ]
    told = ", ".join(kind for kind in kinds if kind)
    return f"{told}; {unit.error(change.size)} across, at ({centre}) {unit.name}"


def region_rows(comparison: SurfaceComparison) -> list[tuple[str, ...]]:
    """Rows of a table of regions, the largest first."""
    unit = shown_unit(comparison.unit)
    return [
        (
            str(number),
            f"{'+' if region.peak > 0 else '−'}{unit.measured(abs(region.peak), region.sigma)}",
            unit.number(region.size),
            plain(unit.factor**3 * region.volume, 2, signed=True),
            ", ".join(unit.number(float(value)) for value in region.centre),
        )
        for number, region in enumerate(comparison.regions, start=1)
    ]


def region_headings(comparison: SurfaceComparison) -> tuple[str, ...]:
    """Headings of those rows."""
    name = shown_unit(comparison.unit).name
    return ("region", f"deviation, {name}", f"across, {name}", f"volume, {name}³", f"centre, {name}")


def quantile_rows(comparison: SurfaceComparison) -> list[tuple[str, str]]:
    """Share of the points, and the deviation that so many do not exceed."""
    unit = shown_unit(comparison.unit)
    distance = comparison.compared
    if not len(distance):
        return []
    values = np.quantile(distance, QUANTILES)
    beside = float(values[-1] - values[0])
    return [
        (f"{100 * share:.0f} %", unit.error(float(value), signed=True, beside=beside))
        for share, value in zip(QUANTILES, values, strict=True)
    ]


def region_table(comparison: SurfaceComparison) -> Table:
    """The regions, for the terminal."""
    table = empty_table("Regions that deviate", *region_headings(comparison)[1:])
    for row in region_rows(comparison)[:_MOST_REGIONS]:
        table.add_row(*row)
    return table
