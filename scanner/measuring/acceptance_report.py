"""An acceptance as a table on the terminal, as `acceptance.json` and as a page."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.table import Table

from calib.finding import Finding, FindingKind, Severity
from scanner.measuring.acceptance import (
    ALLOWED_STRAYS,
    FLATNESS_PLACEMENTS,
    PROBING_PLACEMENTS,
    SPACING_PLACEMENTS,
    Acceptance,
    Error,
)
from scanner.quantities import ShownUnit, empty_table, percent, plain, shown_unit
from scanner.rendering import page
from scanner.results import finding_entries

ACCEPTANCE_FILE, ACCEPTANCE_PAGE = "acceptance.json", "acceptance.html"
_FORMAT = 1
NAMES = {
    "PF": ("Probing error, form", PROBING_PLACEMENTS),
    "PS": ("Probing error, size", PROBING_PLACEMENTS),
    "SD": ("Sphere-spacing error", SPACING_PLACEMENTS),
    "F": ("Flatness measurement error", FLATNESS_PLACEMENTS),
}

FEWER_PLACEMENTS = FindingKind(
    "fewer-placements",
    "An acceptance test has fewer placements of the ball bar than VDI/VDE 2634 part 2 asks for.",
    "Scan the bar in the missing places.",
)
STRAYS = FindingKind(
    "strays",
    "More points of a sphere were left out as strays than the standard allows.",
    "Clear what stands before or behind the balls' rims.",
    ("stray_share",),
)
FLATNESS_OF_FACES = FindingKind(
    "flatness-of-faces",
    "The flatness error was measured on the faces of the corner and contains their unevenness.",
    "Use a calibrated flat.",
)
ROBUST_FIT = FindingKind(
    "robust-fit",
    "Spheres and planes were fitted with Tukey's weights, where the standard asks for least squares.",
)


@dataclass(frozen=True)
class ErrorRow:
    """One error, or the largest of a kind, as text: its name, its cells, and a remark."""

    name: str
    cells: tuple[str, ...]


def summary(acceptance: Acceptance) -> Iterator[ErrorRow]:
    """Return for each kind of error the largest, where it occurred, and how many of the number that the standard
    requires were measured.
    """
    unit = shown_unit(acceptance.unit)
    for quantity, (name, wanted) in NAMES.items():
        worst = acceptance.worst(quantity)
        if worst is not None:
            count = len(acceptance.of(quantity))
            cells = (_value(worst, unit), _sigma(worst, unit), f"{count} of {wanted}")
            yield ErrorRow(f"{quantity}: {name}", cells)


def rows(acceptance: Acceptance, quantity: str) -> Iterator[ErrorRow]:
    """Return the rows of one kind of error."""
    unit = shown_unit(acceptance.unit)
    for error in acceptance.of(quantity):
        sigma = 0.0 if error.budget is None else error.budget.sigma
        over = plain(error.value / sigma, 1, signed=True) if sigma else ""
        dispersion = "" if error.dispersion is None else unit.error(error.dispersion)
        cells = (_value(error, unit), _sigma(error, unit), over, dispersion)
        yield ErrorRow(f"{error.placement}, {error.of}", cells)


def acceptance_findings(acceptance: Acceptance) -> Iterator[Finding]:
    """Yield how this differs from the standard's test."""
    few = [
        f"{name.lower()} {len(acceptance.of(quantity))} of {wanted}"
        for quantity, (name, wanted) in NAMES.items()
        if len(acceptance.of(quantity)) < wanted
    ]
    if few:
        message = f"Fewer placements than VDI/VDE 2634 part 2 asks for: {', '.join(few)}."
        yield Finding(FEWER_PLACEMENTS, Severity.NOTE, message)
    strays = max((error.strays for error in acceptance.errors), default=0.0)
    if strays > ALLOWED_STRAYS:
        yield Finding(
            STRAYS,
            Severity.NOTE,
            f"On a sphere {percent(strays)} of the points were left out as strays, where the standard allows 0.3 %: "
            "they belong to objects in front of or behind its rim, or PF is larger than stated.",
            data={"stray_share": strays},
        )
    if acceptance.of("F"):
        message = (
            "F was measured on the faces of the corner and contains their unevenness. A calibrated flat is the test."
        )
        yield Finding(FLATNESS_OF_FACES, Severity.NOTE, message)
    message = "Spheres and planes were fitted with Tukey's weights, which in clean points are least squares."
    yield Finding(ROBUST_FIT, Severity.NOTE, message)


def _value(error: Error, unit: ShownUnit) -> str:
    return unit.error(error.value, signed=error.budget is not None)


def _sigma(error: Error, unit: ShownUnit) -> str:
    return "" if error.budget is None else f"± {unit.error(error.budget.sigma)}"


def summary_table(acceptance: Acceptance) -> Table:
    """The largest errors, for the terminal."""
    table = empty_table("Acceptance after VDI/VDE 2634 part 2", "largest", "sigma of it", "measured")
    for row in summary(acceptance):
        table.add_row(f"  {row.name}", *row.cells)
    return table


def write_acceptance(path: Path, acceptance: Acceptance) -> None:
    """Write all errors for other programs. Raises OSError."""
    findings = finding_entries(acceptance_findings(acceptance))
    document = {"format": _FORMAT, **asdict(acceptance), "findings": findings}
    path.write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_acceptance_page(path: Path, acceptance: Acceptance) -> None:
    """The page; it needs no network and no other file. Raises OSError."""
    unit = shown_unit(acceptance.unit)
    text = page(
        "acceptance.html",
        summary=list(summary(acceptance)),
        kinds=[(f"{quantity}: {name}", list(rows(acceptance, quantity))) for quantity, (name, _) in NAMES.items()],
        findings=list(acceptance_findings(acceptance)),
        sentences=list(dict.fromkeys(acceptance.sentences)),
        diameters=[unit.length(diameter) for diameter in acceptance.ball_bar.diameters],
        length=unit.length(acceptance.ball_bar.length),
    )
    path.write_text(text, encoding="utf-8")
