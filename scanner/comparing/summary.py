"""A comparison in words and as a table."""

from collections.abc import Iterator

import numpy as np
from rich import box
from rich.table import Table

from calib.numerics import Floats
from scanner.comparing.comparison import CalibrationComparison, Sheet
from scanner.quantities import ShownUnit, plain, shown_unit


def summary(comparison: CalibrationComparison) -> Iterator[str]:
    """The verdict first, then its reasons, in sentences."""
    difference, unit = comparison.difference, shown_unit(comparison.unit)
    worst = int(np.argmax(difference.sigmas if any(comparison.known) else difference.length))
    x, y = difference.camera_px[worst]
    where = f"at camera pixel ({x:.0f}, {y:.0f}), {unit.length(float(difference.depth[worst]))} away"
    size = f"{unit.error(float(difference.length[worst]))} and {difference.px[worst]:.2g} projector px"
    if not any(comparison.known):
        yield f"They differ by up to {size}, {where}. Neither has a covariance: whether that is significant is unknown."
        return
    allowed = unit.error(float(difference.length_sigma[worst]))
    if difference.agree:
        yield (
            f"They agree: the most significant difference is {size}, {where}, where {allowed} is one sigma "
            f"({difference.sigmas[worst]:.1f} sigmas)."
        )
    else:
        yield (
            f"They differ by more than their sigmas allow: by up to {size}, {where}, where {allowed} is one sigma "
            f"({difference.sigmas[worst]:.1f} sigmas)."
        )
    yield (
        f"All differences together: χ² = {difference.chi2:.1f}, where {difference.freedom} is expected and chance "
        f"explains up to {difference.limit:.0f}."
    )
    for name, known in zip(comparison.names, comparison.known, strict=True):
        if not known:
            yield f"{name} has no covariance: the sigmas are those of the other calibration only."
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
    px_sigma = f"{_rms(sheet.px_sigma):.3f}" if known and np.isfinite(sheet.px_sigma).any() else "–"
    px = (f"{_rms(sheet.px):.3f}", f"{np.nanmax(sheet.px):.3f}", px_sigma)
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
