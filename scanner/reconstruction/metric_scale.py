"""The metric scale of a calibration: from one known length, or from a ChArUco sheet that lies in the scanned room."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics import SheetSize, Uncertainty, size_of_sheet
from calib.finding import FindingKind
from calib.geometry import Calibration, Corner
from calib.refusal import RefusalError
from scanner.configuration import CharucoSettings, ScaleSettings
from scanner.errors import InputError
from scanner.quantities import UNKNOWN_UNIT
from scanner.results import Decoded
from scanner.targets import NotFoundError, Target, detect, on_board


def scaled(calibration: Calibration, corner: Corner | None, scale: ScaleSettings | None) -> Calibration:
    """Return the calibration in metres if a length is known; unchanged if none is, or if it has a unit already.

    `corner` is in the calibration's unit. The result's `sigma` records which length was known, and its sigma: 0 if
    exact. Raises InputError if the known length is the distance to a corner and there is none, or if it is that of a
    sheet.
    """
    if scale is None or calibration.unit != UNKNOWN_UNIT:
        return calibration
    if scale.charuco is not None:
        raise InputError("scale.charuco is for captures of a rig, whose projector lights the sheet")
    known = scale.sigma_m or 0.0
    if scale.baseline_m is not None:
        sigma = replace(calibration.sigma, known_baseline=known)
        factor = scale.baseline_m / calibration.baseline
    elif scale.camera_to_corner_m is not None:
        if corner is None:
            raise InputError("scale.camera_to_corner_m needs the corner, which is not looked for with a --calibration")
        sigma = replace(calibration.sigma, known_camera_to_corner=known)
        factor = scale.camera_to_corner_m / float(np.linalg.norm(corner.vertex))
    else:
        return calibration
    return replace(calibration.scaled(factor, "m"), sigma=sigma)


_FEWEST_MATCHES = 300
_MM = 1e-3

NO_SHEET = FindingKind(
    "no-sheet",
    "The printed sheet that gives the scale was not found.",
    "Lay the sheet flat where both devices see it whole and large, or give the scale otherwise.",
)


@dataclass(frozen=True)
class _Sheet:
    """The measured sheet: its points in metres, and the standard deviation of a length's logarithm on it."""

    target: Target
    log_sigma: float


def scaled_by_sheet(
    calibration: Calibration, uncertainty: Uncertainty | None, captures: Sequence[Decoded], settings: CharucoSettings
) -> tuple[Calibration, Uncertainty | None]:
    """A calibration of these captures in metres, by the board in those that show it.

    Its uncertainty includes the correlation of the baseline with the calibration's columns. Raises RefusalError if no
    capture shows it.
    """
    sheet = _Sheet(
        Target("charuco", settings.columns, settings.rows, settings.square_mm * _MM),
        (settings.sigma_mm or 0.0) / settings.square_mm,
    )
    sizes, missing = [], []
    for capture in captures:
        try:
            sizes.append(_size(capture, sheet, calibration, uncertainty))
        except NotFoundError as error:
            missing.append(f"{capture.name}: {error}" if len(captures) > 1 else str(error))
    if not sizes:
        raise RefusalError(
            NO_SHEET,
            f"scale.charuco: {'; '.join(missing)}.",
            "Lay the sheet flat where both devices see it whole and large, or give the scale otherwise: the matches "
            "are kept, and scan calibrate makes a result of them with another scale, or without one.",
        )
    return _scaled(calibration, uncertainty, sizes, sheet.log_sigma)


def _scaled(
    calibration: Calibration, uncertainty: Uncertainty | None, sizes: Sequence[SheetSize], log_sigma: float
) -> tuple[Calibration, Uncertainty | None]:
    """Each size says how long a metre is in the calibration's unit; together they say it by their noise."""
    weight = np.array([size.noise**-2.0 for size in sizes])
    share = weight / weight.sum()
    log_metre = float(share @ [size.log_length for size in sizes])
    variance = 1 / float(weight.sum()) + log_sigma**2
    if uncertainty is not None:
        by_columns = share @ np.stack([size.by_columns for size in sizes])
        variance += float(by_columns @ uncertainty.covariance @ by_columns)
        uncertainty = replace(uncertainty, with_log_baseline=-uncertainty.covariance @ by_columns)
    metric = calibration.scaled(np.exp(-log_metre), "m")
    sigma = replace(calibration.sigma, known_baseline=float(metric.baseline * np.sqrt(variance)))
    return replace(metric, sigma=sigma), uncertainty


def _size(capture: Decoded, sheet: _Sheet, calibration: Calibration, uncertainty: Uncertainty | None) -> SheetSize:
    """Raises NotFoundError."""
    if capture.texture is None:
        raise NotFoundError(f"there is no picture of the lit scene to find {sheet.target} in")
    detected = detect(capture.texture, sheet.target)
    size = capture.metadata.camera_size
    column, row = np.rint(capture.matches.camera_px).astype(np.int64).clip(0, np.array(size) - 1).T
    lit = np.flatnonzero(on_board(detected, sheet.target, size)[row, column])
    if len(lit) < _FEWEST_MATCHES:
        raise NotFoundError(f"{sheet.target} has {len(lit)} matches only: is it lit by the projector?")
    try:
        return size_of_sheet(detected.points, detected.pixels, capture.matches[lit], calibration, uncertainty)
    except ValueError as error:
        raise NotFoundError(f"{sheet.target} was found, but {error}") from error
