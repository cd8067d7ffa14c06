"""Acceptance with a ball bar after VDI/VDE 2634 part 2 (2012), with what ISO 10360-13 (2021) does otherwise.

Probing error: form PF is the range of the points' distances from the best-fit sphere, size PS its diameter less the
calibrated one. Sphere-spacing error SD is the distance of two spheres' centres less the calibrated one. Flatness
measurement error F is the range of points' distances from the best-fit plane. PF and F leave out 0.3 % of the points;
the form errors of ISO 10360-13 (Form.Sph.D95%, Form.Pla.D95%) leave out 5 %.
"""

from dataclasses import dataclass

import numpy as np

from calib.diagnostics import Budget
from scanner.errors import InputError
from scanner.measuring.measure import measure
from scanner.measuring.measurements import FitErrors, MeasuredScene
from scanner.quantities import parse_length
from scanner.results import FinishedScan

# Placements that VDI/VDE 2634 part 2 asks for: spheres for probing errors, lines for spacing, planes for flatness.
PROBING_PLACEMENTS, SPACING_PLACEMENTS, FLATNESS_PLACEMENTS = 10, 7, 6
# Share of outliers allowed; beyond it, the standard's form error is larger than the stated one.
ALLOWED_STRAYS = 0.003
_DISPERSION = 0.95


@dataclass(frozen=True)
class BallBar:
    """Calibrated diameters of the two spheres and the distance of their centres."""

    diameters: tuple[float, float]
    length: float


@dataclass(frozen=True)
class Error:
    """One error: measured minus calibrated `value`, or a range due to the scanner and the artefact only.

    `quantity`: PF, PS, SD or F; `of`: what it was measured on; `placement`: name of the result. `budget`: of the
    measured value, None for ranges. `dispersion`: for ranges, that of 95 % of the points. `strays`: share of the points
    removed before.
    """

    quantity: str
    placement: str
    of: str
    value: float
    budget: Budget | None = None
    dispersion: float | None = None
    strays: float = 0.0


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
