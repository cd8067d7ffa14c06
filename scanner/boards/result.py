"""A calibration from boards as a folder, on the terminal, and as report.html: whether it can be trusted, in words, and
what shows it.
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup, escape
from rich import box
from rich.table import Table

from calib.boards import INTRINSIC_COLUMNS, ray_sigmas, rig_uncertainty
from calib.geometry import Size
from calib.numerics import Floats
from scanner.boards.calibrate import BoardCapture, FromBoards
from scanner.io import write_calibration
from scanner.quantities import plain, rig_quantities
from scanner.rendering import jpeg_uri, page, photograph
from scanner.results import CALIBRATION_FILE, REPORT_FILE, Verdict, covariance_entries, verdict_entries
from scanner.targets import UNIT

_MEASUREMENT_GRADE = 0.003  # sigma of a focal length
_USEFUL_RAY_PX = 1.0
_SURPRISING = 2.0  # difference of the halves, in their sigmas
_NAMES = (
    "camera_log_focal",
    "camera_x0_px",
    "camera_y0_px",
    "projector_log_focal",
    "projector_x0_px",
    "projector_y0_px",
)


def verdict_on(result: FromBoards) -> Verdict:
    """Good where both focals and all rays are known well and the halves agree."""
    calibrated = result.calibrated
    calibration, sigma = calibrated.calibration, calibrated.calibration.sigma
    relative = [
        sigmas.focal_px[0] / device.focal_px[0] if sigmas.focal_px else float("inf")
        for device, sigmas in ((calibration.camera, sigma.camera), (calibration.projector, sigma.projector))
    ]
    rays = [float(np.nanmax(sigmas)) for sigmas in ray_sigmas(calibrated.estimate, result.calibrated.calibration.sizes)]
    predicted = float(np.sqrt(np.mean([prediction.error_px**2 for prediction in calibrated.predictions])))
    expected = float(np.sqrt(np.mean([prediction.expected_px**2 for prediction in calibrated.predictions])))
    reasons = [
        f"Focal lengths are known to {100 * relative[0]:.2g} % (camera) and {100 * relative[1]:.2g} % (projector), "
        f"rays to {rays[0]:.2g} and {rays[1]:.2g} px over the common view (1 sigma).",
        f"Each board is predicted by the others to {predicted:.2g} projector px; {expected:.2g} px were expected.",
    ]
    if calibrated.halves is not None:
        reasons.append(
            "Calibrations from either half of the boards: focal lengths and principal points differ by "
            f"{calibrated.halves.sigmas:.1f} of their sigmas (root mean square; 1 is expected)."
        )
    reasons += calibrated.coverage.reasons and [f"How the boards were held: {'; '.join(calibrated.coverage.reasons)}."]
    doubtful = calibrated.halves is not None and calibrated.halves.sigmas > _SURPRISING
    if max(relative) < _MEASUREMENT_GRADE and max(rays) < _USEFUL_RAY_PX and not doubtful:
        return Verdict("good", "Calibrated, well enough to measure", tuple(reasons), findings=result.findings)
    if doubtful:
        return Verdict(
            "fair",
            "Calibrated, but two halves of the boards disagree",
            tuple(reasons),
            "Something changed between the captures, or the boards differ: make sure that nothing moves "
            "or is refocused, and that the board is flat and firm.",
            result.findings,
        )
    return Verdict(
        "fair",
        "Calibrated, less precisely than boards can",
        tuple(reasons),
        "More captures lower the sigmas: boards at other tilts, and where the pictures are still empty.",
        result.findings,
    )


_DOTS = 2500
_THUMB = 420
_HALVES = (
    *(("camera", "focal length", "%"), ("camera", "principal point x₀", "px"), ("camera", "principal point y₀", "px")),
    *(("projector", "focal length", "%"), ("projector", "principal point x₀", "px")),
    ("projector", "principal point y₀", "px"),
)


def write_page(path: Path, result: FromBoards) -> None:
    """Write the page; it needs no network and no other file. Raises OSError."""
    calibrated = result.calibrated
    sizes = calibrated.calibration.sizes
    rays = ray_sigmas(calibrated.estimate, sizes)
    text = page(
        "board.html",
        verdict=verdict_on(result),
        subtitle=f"{result.target}, squares of {result.target.square:g} mm, {len(calibrated.predictions)} captures",
        tables=rig_quantities(result.calibrated.calibration),
        rows=rows(result),
        halves=_halves(result),
        coverage=[
            ("camera", _coverage([capture.view.corners_px for capture in result.captures], sizes[0], "corners")),
            (
                "projector",
                _coverage([capture.view.cells.projector_px for capture in result.captures], sizes[1], "matches"),
            ),
        ],
        rays=[("camera", _ray_rows(rays[0])), ("projector", _ray_rows(rays[1]))],
        pictures=[(capture.view.name, _picture(capture)) for capture in result.captures],
        tilt=f"{calibrated.coverage.tilt_deg:.0f}",
        distances=f"{calibrated.coverage.distances:.2f}",
    )
    path.write_text(text, encoding="utf-8")


def rows(result: FromBoards) -> list[tuple[str, ...]]:
    """Return a row per board, predicted from the others: name, error, expected error, error in sigmas, change of the
    focal lengths.
    """
    focals = [INTRINSIC_COLUMNS[0], INTRINSIC_COLUMNS[3]]
    return [
        (
            prediction.name,
            f"{prediction.error_px:.3f}",
            f"{prediction.expected_px:.3f}",
            f"{prediction.sigmas:.1f}",
            *(f"{plain(100 * moved, 2, signed=True)} %" for moved in prediction.moved[focals]),
        )
        for prediction in result.calibrated.predictions
    ]


def _halves(result: FromBoards) -> list[tuple[str, str, str, str]]:
    """Return a row per parameter: its name, the difference between the halves, the sigma of the difference, and their
    ratio.
    """
    halves = result.calibrated.halves
    if halves is None:
        return []
    table = []
    for (device, name, unit), difference, sigma in zip(_HALVES, halves.difference, halves.sigma, strict=True):
        factor, decimals = (100.0, 3) if unit == "%" else (1.0, 2)
        columns = [
            plain(factor * value, decimals, signed=signed) for value, signed in ((difference, True), (sigma, False))
        ]
        table.append(
            (
                f"{device}, {name}",
                *(f"{column} {unit}" for column in columns),
                plain(difference / sigma, 1, signed=True),
            )
        )
    return [(a, b, c, d) for a, b, c, d in table]


def _ray_rows(sigmas: Floats) -> list[list[str]]:
    """Return every third value of the grid as text; '' where the other device does not see."""
    return [["" if np.isnan(value) else f"{value:.2f}" for value in row] for row in sigmas[::3, ::3]]


def _coverage(pixels: list[Floats], size: Size, what: str) -> Markup:
    """Plot where the boards were in a picture."""
    every = np.concatenate(pixels)
    every = every[:: max(1, len(every) // _DOTS)]
    radius = max(size) / 220
    dots = "".join(f'<circle cx="{x:.0f}" cy="{y:.0f}" r="{radius:.1f}"/>' for x, y in every)
    return Markup(
        f'<svg class="plot" style="min-width:0" role="img" aria-label="{escape(f"{what} over the picture")}" '
        f'viewBox="0 0 {size.width} {size.height}"><rect width="{size.width}" height="{size.height}" fill="none" '
        f'stroke="currentColor" stroke-width="{radius:.1f}"/><g fill="var(--accent)">{dots}</g></svg>'
    )


def _picture(capture: BoardCapture) -> str:
    """The capture under white light with the corners that were found, small, as a data URI."""
    picture = photograph(capture.texture, _THUMB)
    factor = np.divide(picture.shape[1::-1], capture.texture.shape[1::-1])
    for x, y in np.rint((capture.view.corners_px + 0.5) * factor - 0.5).astype(int):
        cv2.circle(picture, (int(x), int(y)), 1, (240, 140, 0), -1)
    return jpeg_uri(picture)


def save_result(result: FromBoards, folder: Path) -> None:
    """calibration.yaml and report.html. Raises OSError."""
    write_calibration(folder / CALIBRATION_FILE, result.calibrated.calibration, _more(result))
    write_page(folder / REPORT_FILE, result)


def _more(result: FromBoards) -> dict[str, Any]:
    """Return the keys of calibration.yaml beyond the calibration itself."""
    calibrated = result.calibrated
    halves = calibrated.halves
    return {
        **verdict_entries(verdict_on(result)),
        "board": {
            "kind": str(result.target),
            f"square_{UNIT}": result.target.square,
            "bend": [float(value) for value in calibrated.estimate.state.bend],
            "captures": [
                {
                    "name": prediction.name,
                    "leave_one_out_px": round(prediction.error_px, 4),
                    "expected_px": round(prediction.expected_px, 4),
                    "corner_px": round(float(corner), 4),
                }
                for prediction, corner in zip(calibrated.predictions, calibrated.estimate.corner_px, strict=True)
            ],
            "left_out": [{"name": odd.name, "leave_one_out_px": round(odd.error_px, 4)} for odd in calibrated.left_out]
            + [{"name": capture.name, "why": capture.why} for capture in result.missing],
            "halves": None
            if halves is None
            else {
                name: {"difference": float(difference), "sigma": float(sigma)}
                for name, difference, sigma in zip(_NAMES, halves.difference, halves.sigma, strict=True)
            },
            "sigmas_enlarged_by": round(calibrated.enlarged, 3),
        },
        **covariance_entries(rig_uncertainty(calibrated.estimate, result.calibrated.calibration.sizes)),
    }


def summary(result: FromBoards) -> Table:
    """Return a table for the terminal: each board, predicted from the others."""
    table = Table(
        title="Each board, predicted by the others (projector px)", title_justify="left", box=box.SIMPLE, pad_edge=False
    )
    table.add_column("", overflow="fold")
    for heading in ("off by", "expected", "in sigmas", "moves f_c by", "f_p by"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows(result):
        table.add_row(*row)
    return table
