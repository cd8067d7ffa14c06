"""`measure.json`: the measurements for other programs."""

import json
from pathlib import Path
from typing import Any

from scanner.measuring.measurements import FORM_SHARE, FitErrors, Measurements

MEASURE_FILE = "measure.json"
FORMAT = 1


def write_document(path: Path, measured: Measurements, result: str) -> None:
    """Write all numbers; lengths are in `unit`, `null` is for what is not known. Raises OSError."""
    path.write_text(json.dumps(_document(measured, result), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def _document(measured: Measurements, result: str) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "result": result,
        "unit": measured.unit,
        "form_share": FORM_SHARE,
        "spheres": [
            {
                "nominal_diameter": sphere.nominal_diameter,
                "diameter": sphere.diameter,
                "diameter_sigma": sphere.diameter_sigma,
                "centre": sphere.centre.tolist(),
                "centre_sigma": sphere.centre_sigma.tolist(),
                "image_px": {"centre": list(sphere.image_px[:2]), "radius": sphere.image_px[2]},
                **_errors(sphere.errors),
                "strays": sphere.strays,
                "with_nominal_diameter": _errors(sphere.nominal_errors),
            }
            for sphere in measured.spheres
        ],
        "faces": [
            {"name": face.name, "normal": face.normal.tolist(), "offset": face.offset, **_errors(face.errors)}
            for face in measured.faces
        ],
        "angles": [
            {"faces": list(angle.faces), "angle_deg": angle.angle_deg, "sigma_deg": angle.sigma_deg}
            for angle in measured.angles
        ],
        "distances": [
            {
                "between": list(distance.names),
                "points": distance.points.tolist(),
                "distance": distance.distance,
                "sigma": distance.sigma,
            }
            for distance in measured.distances
        ],
    }


def _errors(errors: FitErrors) -> dict[str, float | int]:
    return {
        "points": len(errors.residual),
        "mean_absolute_error": errors.mean_absolute,
        "rms_error": errors.rms,
        "form_error": errors.form,
    }
