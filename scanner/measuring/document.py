"""Measurements as tables on the terminal, and for other programs, as `measure.json`."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from calib.diagnostics import Budget
from scanner.measuring.measurements import (
    FORM_SHARE,
    AngleMeasurement,
    FitErrors,
    MeasuredScene,
    Measurements,
    PointAngle,
    SphereMeasurement,
)
from scanner.quantities import Quantity, ShownUnit, empty_table, fine_unit, shown_unit

_SHARES = ("scatter", "smooth", "calibration", "scale", "poses")
MEASURE_FILE = "measure.json"
FORMAT = 1


def tables(measured: Measurements) -> Iterator[Table]:
    """A table for each kind of thing that was measured."""
    unit = shown_unit(measured.unit)
    for number, sphere in enumerate(measured.spheres, start=1):
        yield _sphere_table(sphere, number, unit)
    if measured.scene.faces:
        fine = fine_unit(measured.unit)
        table = empty_table(f"Faces, {fine.name}", "flatness", "points", "rms", "99.7 % within")
        for face in measured.scene.faces:
            flatness = fine.measured(face.deviation, face.budget.sigma)
            cells = (f"{len(face.errors.residual):,}", fine.number(face.errors.rms), fine.number(face.errors.form))
            table.add_row(f"  {face.name}", flatness, *cells)
        yield table
    if measured.scene.angles:
        table = empty_table("Angles between the faces", "angle", "sigma")
        for angle in measured.scene.angles:
            names = f"  {angle.faces[0]} and {angle.faces[1]}"
            table.add_row(names, *angle_cells(angle))
        yield table
    if measured.distances:
        table = empty_table("Distances", "distance")
        for distance in measured.distances:
            names = f"  {distance.names[0]} to {distance.names[1]}"
            table.add_row(names, unit.length(distance.distance, distance.budget.sigma if distance.budget else None))
        yield table


def angle_cells(angle: AngleMeasurement | PointAngle) -> tuple[str, str]:
    """The angle and its sigma, with two digits of the latter; '' for a sigma that is not known."""
    sigma = angle.budget.sigma if angle.budget else None
    quantity = Quantity("", angle.angle_deg, "°", sigma)
    return f"{quantity.shown(angle.angle_deg)}°", "" if sigma is None else f"± {quantity.shown(sigma)}°"


def shares_table(measured: Measurements) -> Table:
    """Return a table of the contributions to each sigma."""
    unit = shown_unit(measured.unit)
    table = empty_table("Shares of the sigmas", "sigma", *_SHARES)
    rows: list[tuple[str, Budget, float]] = []
    for number, sphere in enumerate(measured.spheres, start=1):
        rows.append((f"diameter {number}, {unit.name}", sphere.diameter_budget, unit.factor))
    rows += [(f"flatness {face.name}, {unit.name}", face.budget, unit.factor) for face in measured.scene.faces]
    rows += [(f"angle {'–'.join(angle.faces)}, °", angle.budget, 1.0) for angle in measured.scene.angles]
    for distance in measured.distances:
        if distance.budget:
            rows.append((f"{' to '.join(distance.names)}, {unit.name}", distance.budget, unit.factor))
    if measured.scene.lengths:
        rows.append(("lengths in the middle, %", measured.scene.lengths.budget, 100.0))
    for name, budget, factor in rows:
        values = (budget.sigma, *(getattr(budget, share) for share in _SHARES))
        table.add_row(f"  {name}", *(f"{factor * value:.2g}" for value in values))
    return table


def _sphere_table(sphere: SphereMeasurement, number: int, unit: ShownUnit) -> Table:
    x, y, radius = sphere.image_px
    table = empty_table(f"Sphere {number}, at camera pixel ({x:.0f}, {y:.0f}), {2 * radius:.0f} pixels across", "")
    for name, value in (
        ("diameter", unit.length(sphere.diameter, sphere.diameter_budget.sigma)),
        ("nominal diameter", unit.length(sphere.nominal_diameter)),
        ("size error", unit.error(sphere.diameter - sphere.nominal_diameter, signed=True)),
        ("points", f"{len(sphere.errors.residual):,}"),
        ("strays, left out", f"{sphere.strays:,}"),
        ("mean absolute error", unit.error(sphere.errors.mean_absolute)),
        ("rms", unit.error(sphere.errors.rms)),
        ("99.7 % of the points within", unit.error(sphere.errors.form)),
        ("mean absolute error, nominal size", unit.error(sphere.nominal_errors.mean_absolute)),
    ):
        table.add_row(f"  {name}", value)
    return table


def write_document(path: Path, measured: Measurements, result: str) -> None:
    """Write all numbers; lengths are in `unit`, `null` means unknown. Raises OSError."""
    path.write_text(json.dumps(_document(measured, result), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def _document(measured: Measurements, result: str) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "result": result,
        "unit": measured.unit,
        "form_share": FORM_SHARE,
        "known_lengths": _lengths(measured.scene),
        "spheres": [
            {
                "nominal_diameter": sphere.nominal_diameter,
                "diameter": sphere.diameter,
                "diameter_sigma": sphere.diameter_budget.sigma,
                "diameter_shares": asdict(sphere.diameter_budget),
                "centre": sphere.centre.tolist(),
                "centre_sigma": [sphere.spread.budget(axis).sigma for axis in range(3)],
                "image_px": {"centre": list(sphere.image_px[:2]), "radius": sphere.image_px[2]},
                **_errors(sphere.errors),
                "strays": sphere.strays,
                "with_nominal_diameter": _errors(sphere.nominal_errors),
            }
            for sphere in measured.spheres
        ],
        "faces": [
            {
                "name": face.name,
                "normal": face.normal.tolist(),
                "offset": face.offset,
                "flatness": face.deviation,
                "flatness_sigma": face.budget.sigma,
                "flatness_shares": asdict(face.budget),
                **_errors(face.errors),
            }
            for face in measured.scene.faces
        ],
        "angles": [
            {
                "faces": list(angle.faces),
                "angle_deg": angle.angle_deg,
                "sigma_deg": angle.budget.sigma,
                "shares_deg": asdict(angle.budget),
            }
            for angle in measured.scene.angles
        ],
        "distances": [
            {
                "between": list(distance.names),
                "points": distance.points.tolist(),
                "distance": distance.distance,
                "sigma": distance.budget.sigma if distance.budget else None,
                "shares": asdict(distance.budget) if distance.budget else None,
            }
            for distance in measured.distances
        ],
    }


def _lengths(scene: MeasuredScene) -> dict[str, Any]:
    known = scene.lengths
    if known is None:
        return {"sentence": scene.sentence, "relative_sigma": None, "at": None}
    return {
        "sentence": scene.sentence,
        "relative_sigma": known.budget.sigma,
        "relative_shares": asdict(known.budget),
        "at": known.middle.tolist(),
    }


def _errors(errors: FitErrors) -> dict[str, float | int]:
    return {
        "points": len(errors.residual),
        "mean_absolute_error": errors.mean_absolute,
        "rms_error": errors.rms,
        "form_error": errors.form,
    }
