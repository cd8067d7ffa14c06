"""The covariance of a calibration in the parameters that other programs have: focal lengths in pixels, and a
translation with its length.

Columns are f_x, f_y, c_x, c_y, k1, k2, p1, p2, k3 of the camera, then of the projector; a small rotation vector ω in
the projector's frame, by which R becomes exp([ω]×) R; and the translation T in the calibration's unit, of
X_projector = R X_camera + T. It is propagated to first order: Σ' = J Σ Jᵀ.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.diagnostics import Uncertainty
from calib.geometry import Calibration
from calib.numerics import Floats
from calib.refinement import CAMERA, PER_DEVICE, PROJECTOR, ROTATION, SHARED, TRANSLATION
from scanner.results import CALIBRATION_FILE, read_uncertainty

COVARIANCE_FILE = "covariance.txt"

_OF_DEVICE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
PARAMETERS = (
    *(f"{device}_{name}" for device in ("camera", "projector") for name in _OF_DEVICE),
    *(f"rotation_{axis}" for axis in "xyz"),
    *(f"translation_{axis}" for axis in "xyz"),
)
EXPLANATION = """Covariance of both devices' parameters, 24 rows and columns; square roots of its diagonal are sigmas.
fx fy cx cy k1 k2 p1 p2 k3 of the camera, then of the projector, in pixels where they have a unit;
rotation: a small rotation vector w in radians, by which R becomes exp([w]x) R; translation: T, in the
calibration's unit, with the sigma of a baseline that is known. X_projector = R X_camera + T. Zeros were held fixed."""


@dataclass(frozen=True, eq=False)
class ExportedCovariance:
    """`values` (24, 24), in the order of `PARAMETERS`."""

    values: Floats

    @property
    def lines(self) -> Iterator[str]:
        """The rows as text, each after its parameter's name, below the explanation."""
        for line in EXPLANATION.splitlines():
            yield f"# {line}"
        yield f"# PARAMETER {' '.join(PARAMETERS)}"
        for name, row in zip(PARAMETERS, self.values, strict=True):
            yield f"{name} {' '.join(repr(float(value)) for value in row)}"


def covariance_of_result(folder: Path, calibration: Calibration) -> ExportedCovariance | None:
    """That of a result's calibration; None if its method states none. Raises InputError if it is malformed."""
    uncertainty = read_uncertainty(folder / CALIBRATION_FILE, calibration)
    return None if uncertainty is None else covariance_of_calibration(calibration, uncertainty)


def covariance_of_calibration(calibration: Calibration, uncertainty: Uncertainty) -> ExportedCovariance:
    """From the covariance of a calibration's columns, and that of the length that gave its unit."""
    by_columns = _jacobian(calibration)
    relative = (calibration.sigma.known_baseline or 0.0) / calibration.baseline
    joint = np.zeros((SHARED + 1, SHARED + 1))
    joint[:SHARED, :SHARED] = uncertainty.covariance
    joint[:SHARED, SHARED] = joint[SHARED, :SHARED] = uncertainty.with_log_baseline
    joint[SHARED, SHARED] = relative**2
    values = by_columns @ joint @ by_columns.T
    return ExportedCovariance((values + values.T) / 2)


def _jacobian(calibration: Calibration) -> Floats:
    """Derivatives (24, 22) of the parameters by the columns, and by the logarithm of the baseline."""
    by_columns = np.zeros((len(PARAMETERS), SHARED + 1))
    for device, columns, first in (
        (calibration.camera, CAMERA, 0),
        (calibration.projector, PROJECTOR, len(_OF_DEVICE)),
    ):
        by_columns[first : first + 2, columns.start] = device.focal_px
        rest = np.arange(1, PER_DEVICE)
        by_columns[first + 1 + rest, columns.start + rest] = 1.0
    turn = 2 * len(_OF_DEVICE)
    by_columns[turn : turn + 3, ROTATION] = np.eye(3)
    by_columns[turn + 3 :, TRANSLATION] = calibration.pose.by_direction
    by_columns[turn + 3 :, SHARED] = calibration.pose.translation
    return by_columns
