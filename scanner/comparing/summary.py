"""A comparison in words and as a table."""

from collections.abc import Iterator

import numpy as np
from rich import box
from rich.table import Table

from calib.numerics import Floats
from scanner.comparing.comparison import CalibrationComparison, Sheet
from scanner.quantities import ShownUnit, plain, shown_unit
from scanner.results import Verdict

PX = ShownUnit(1.0, "projector px")
_NEGLIGIBLE = 0.05  # standard deviations
_ROUNDED = 1e-9  # of the depth: what writing and reading a file does


def comparison_verdict(comparison: CalibrationComparison) -> Verdict:
    """Whether the standard deviations explain the differences, and where the most significant one is."""
    if float(np.max(comparison.difference.length / comparison.difference.depth)) < _ROUNDED:
        return Verdict("good", "The calibrations are the same.", ("They differ by rounding alone.",))
    reasons = (_worst(comparison), *_reasons(comparison))
    if not any(comparison.known):
        headline = "Whether the calibrations differ significantly is not known: neither states a covariance."
        return Verdict("fair", headline, reasons, "Compare with a result of scan calibrate or scan board, which do.")
    if comparison.difference.agree:
        return Verdict("good", "The calibrations agree, as their standard deviations say.", reasons)
    return Verdict(
        "refused",
        "The calibrations differ by more than their standard deviations allow.",
        reasons,
        "If the rig was not changed in between, calibrate again, from more views.",
    )


def _worst(comparison: CalibrationComparison) -> str:
    difference, unit, known = comparison.difference, shown_unit(comparison.unit), any(comparison.known)
    worst = int(np.argmax(difference.sigmas if known else difference.length))
    x, y = difference.camera_px[worst]
    length, px = unit.error(float(difference.length[worst])), PX.error(float(difference.px[worst]))
    where = f"at camera pixel ({x:.0f}, {y:.0f}), {unit.length(float(difference.depth[worst]))} away"
    if not known:
        return f"The largest difference is {length}, or {px}, {where}."
    if difference.sigmas[worst] < _NEGLIGIBLE:
        return "Everywhere they differ by less than a twentieth of a standard deviation."
    allowed = unit.error(float(difference.length_sigma[worst]))
    return (
        f"The most significant difference is {length}, or {px}, {where}: {plain(float(difference.sigmas[worst]), 1)} "
        f"standard deviations, each {allowed}."
    )


def _reasons(comparison: CalibrationComparison) -> Iterator[str]:
    difference, unit = comparison.difference, shown_unit(comparison.unit)
    if any(comparison.known):
        yield (
            f"All differences together: χ² = {plain(difference.chi2, 1)}, where {difference.freedom} is expected and "
            f"chance explains up to {plain(difference.limit, 0)}."
        )
        for name, known in zip(comparison.names, comparison.known, strict=True):
            if not known:
                yield f"{name} has no covariance: the standard deviations are those of the other calibration only."
        if difference.unexplained > float(np.sqrt(np.mean(difference.length_sigma**2))):
            yield (
                f"{unit.error(difference.unexplained)} of it (root mean square) is of a kind that neither covariance "
                "contains, such as lens terms that only one of them has."
            )
    if not comparison.metric:
        yield "They share no known length, so one was scaled to fit best: the differences are in shape only."


def headings(comparison: CalibrationComparison) -> tuple[str, ...]:
    """Return the column headings of `rows`."""
    name = shown_unit(comparison.unit).name
    return (f"depth, {name}", "px, rms", "max", "sigma", f"{name}, rms", "max", "sigma", "in sigmas")


def rows(comparison: CalibrationComparison) -> list[tuple[str, ...]]:
    """Return a row per depth: differences in projector pixels and as lengths, and those expected from one sigma of both
    results.
    """
    return [_row(sheet, shown_unit(comparison.unit), known=any(comparison.known)) for sheet in comparison.sheets]


def _row(sheet: Sheet, unit: ShownUnit, *, known: bool) -> tuple[str, ...]:
    if np.isnan(sheet.length).all():
        return (unit.number(sheet.depth), *["–"] * 7)
    # A covariance may reach rigs whose projector has no pixel for any of the points.
    px_sigma = PX.number(_rms(sheet.px_sigma)) if known and np.isfinite(sheet.px_sigma).any() else "–"
    px = (PX.number(_rms(sheet.px)), PX.number(float(np.nanmax(sheet.px))), px_sigma)
    lengths = (unit.number(_rms(sheet.length)), unit.number(float(np.nanmax(sheet.length))))
    allowed = unit.number(_rms(sheet.length_sigma)) if known else "–"
    over = plain(_rms(sheet.length / sheet.length_sigma), 1) if known else "–"
    return (unit.number(sheet.depth), *px, *lengths, allowed, over)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def table(comparison: CalibrationComparison) -> Table:
    """Return those rows as a table for the terminal."""
    made = Table(title="Differences by depth", title_justify="left", box=box.SIMPLE, pad_edge=False)
    for heading in headings(comparison):
        made.add_column(heading, justify="right", no_wrap=True)
    for row in rows(comparison):
        made.add_row(*row)
    return made
