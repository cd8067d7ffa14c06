"""A calibration from boards as a folder, and on the terminal."""

from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from calib.boards import rig_uncertainty
from scanner.boards.calibrate import FromBoards
from scanner.boards.page import rows, verdict_on, write_page
from scanner.io import write_calibration
from scanner.results import CALIBRATION_FILE, REPORT_FILE, covariance_entries, verdict_entries
from scanner.targets import UNIT

_NAMES = (
    "camera_log_focal",
    "camera_x0_px",
    "camera_y0_px",
    "projector_log_focal",
    "projector_x0_px",
    "projector_y0_px",
)


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
