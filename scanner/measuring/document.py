"""`measure.json`: the measurements for other programs."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from scanner.measuring.measurements import FORM_SHARE, FitErrors, MeasuredScene, Measurements

MEASURE_FILE = "measure.json"
FORMAT = 1


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
