"""Acceptance with a ball bar after VDI/VDE 2634 part 2 (2012), with what ISO 10360-13 (2021) does otherwise.

Probing error: form PF is the range of the points' distances from the best-fit sphere, size PS its diameter less the
calibrated one. Sphere-spacing error SD is the distance of two spheres' centres less the calibrated one. Flatness
measurement error F is the range of points' distances from the best-fit plane. PF and F leave out 0.3 % of the points;
the form errors of ISO 10360-13 (Form.Sph.D95%, Form.Pla.D95%) leave out 5 %.

An acceptance as a table on the terminal, as `acceptance.json` and as a page.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from calib.diagnostics import Budget
from calib.finding import Finding, FindingKind, Severity
from scanner.errors import InputError
from scanner.measuring.measure import measure
from scanner.measuring.measurements import FitErrors, MeasuredScene
from scanner.quantities import ShownUnit, empty_table, parse_length, percent, plain, shown_unit
from scanner.rendering import page
from scanner.results import FinishedScan, finding_entries

# Placements that VDI/VDE 2634 part 2 asks for: spheres for probing errors, lines for spacing, planes for flatness.
PROBING_PLACEMENTS, SPACING_PLACEMENTS, FLATNESS_PLACEMENTS = 10, 7, 6
# Share of outliers allowed; beyond it, the standard's form error is larger than the stated one.
ALLOWED_STRAYS = 0.003
_DISPERSION = 0.95
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
class BallBar:
    """Calibrated diameters of the two spheres and the distance of their centres."""

    diameters: tuple[float, float]
    length: float


@dataclass(frozen=True)
class Error:
    """One error: measured minus calibrated value, or a range due to the scanner and the artefact only."""

    quantity: str
    """PF, PS, SD or F."""
    placement: str
    """Name of the result."""
    of: str
    """What it was measured on."""
    value: float
    budget: Budget | None = None
    """Of the measured value, None for ranges."""
    dispersion: float | None = None
    """For ranges, that of 95 % of the points."""
    strays: float = 0.0
    """Share of the points removed before."""


@dataclass(frozen=True)
class Acceptance:
    """All errors of all placements, in `unit`, and the uncertainty of lengths stated by each result."""

    unit: str
    ball_bar: BallBar
    errors: tuple[Error, ...]
    sentences: tuple[str, ...]

    def of(self, quantity: str) -> tuple[Error, ...]:
        """The errors of one kind."""
        return tuple(error for error in self.errors if error.quantity == quantity)

    def worst(self, quantity: str) -> Error | None:
        """Return the largest error of a kind, which is the one that counts; None if there is none."""
        return max(self.of(quantity), key=lambda error: abs(error.value), default=None)


def parse_ball_bar(text: str, unit: str) -> BallBar:
    """'50.02mm,50.01mm,200.13mm', or three numbers in `unit`. Raises InputError."""
    parts = text.split(",")
    if len(parts) != 3:
        raise InputError(
            f"--ball-bar {text}: expected two diameters and the distance of the centres, as in 50.02mm,50.01mm,200.13mm"
        )
    first, second, length = (parse_length(part, unit) for part in parts)
    if length <= (first + second) / 2:
        raise InputError(
            f"--ball-bar {text}: spheres whose centres are {length:g} {unit} apart would overlap: the distance comes "
            "last, and diameters are not radii"
        )
    return BallBar((first, second), length)


def errors_of(name: str, scan: FinishedScan, scene: MeasuredScene, ball_bar: BallBar) -> tuple[Error, ...]:
    """Compute the errors of one placement. Raises NoMeasurementError if a sphere is not found."""
    measured = measure(scan, scene, list(ball_bar.diameters))
    errors: list[Error] = []
    for number, (sphere, nominal) in enumerate(zip(measured.spheres, ball_bar.diameters, strict=True), start=1):
        of, points = f"sphere {number}", len(sphere.errors.residual)
        share = sphere.strays / (points + sphere.strays)
        errors.append(_form("PF", name, of, sphere.errors, share))
        errors.append(Error("PS", name, of, sphere.diameter - nominal, sphere.diameter_budget))
    (spacing,) = measured.distances
    errors.append(Error("SD", name, "spheres 1 and 2", spacing.distance - ball_bar.length, spacing.budget))
    errors += [_form("F", name, f"face {face.name}", face.errors, 0.0) for face in measured.scene.faces]
    return tuple(errors)


def _form(quantity: str, name: str, of: str, errors: FitErrors, strays: float) -> Error:
    low, high = np.quantile(errors.residual, ((1 - _DISPERSION) / 2, (1 + _DISPERSION) / 2))
    return Error(quantity, name, of, errors.form, None, float(high - low), strays)


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
