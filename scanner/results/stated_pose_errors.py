"""The errors of the poses of captures or stations as keys of the file that lists the poses."""

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from calib.diagnostics import PoseErrors
from calib.geometry import PER_POSE
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.io import Entry, Number, read_yaml, validate
from scanner.results.stated_uncertainty import COLUMNS, columns_of_file

_MOST_VARIANCE = 1e24  # squared units of a scene


class _PoseErrorsEntry(Entry):
    pose_covariance: list[list[Number]] = Field(default_factory=list)
    pose_by_calibration: list[list[Number]] = Field(default_factory=list)


def pose_error_entries(errors: PoseErrors, direction: Floats) -> dict[str, Any]:
    """Keys with a row for each of six numbers of each pose; none where the poses are not determined.

    `direction` (3,): of the calibration's translation, to whose three components a file's columns refer.
    """
    if not (np.isfinite(errors.covariance).all() and np.isfinite(errors.by_calibration).all()):
        return {}
    by_file = errors.by_calibration @ columns_of_file(direction / np.linalg.norm(direction)).T
    return {"pose_covariance": errors.covariance.tolist(), "pose_by_calibration": by_file.tolist()}


def read_pose_errors(path: Path, count: int, direction: Floats) -> PoseErrors | None:
    """The errors of `count` poses; None where the file states none. Raises InputError if they are malformed."""
    entry = validate(_PoseErrorsEntry, read_yaml(path), str(path))
    if not entry.pose_covariance:
        return None
    rows = PER_POSE * count
    for key, matrix, columns in (
        ("pose_covariance", entry.pose_covariance, rows),
        ("pose_by_calibration", entry.pose_by_calibration, len(COLUMNS)),
    ):
        if len(matrix) != rows or any(len(row) != columns for row in matrix):
            raise InputError(f"{path}: '{key}' must be {rows} rows of {columns} numbers")
    covariance = np.array(entry.pose_covariance)
    diagonal = np.diag(covariance)
    if diagonal.min() < 0 or diagonal.max() > _MOST_VARIANCE or not np.allclose(covariance, covariance.T):
        raise InputError(f"{path}: 'pose_covariance' is no covariance: negative, not symmetric, or beyond any scene")
    return PoseErrors(
        covariance, np.array(entry.pose_by_calibration) @ columns_of_file(direction / np.linalg.norm(direction))
    )
