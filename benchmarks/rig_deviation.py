"""Errors of a calibration in its own sigmas, parameter by parameter."""

import numpy as np

from calib.geometry import Calibration
from calib.numerics import Floats
from calib.refinement import CAMERA, PROJECTOR, State, device_of
from calib.self_calibration import SelfCalibration

_DEVICE = ("f", "x0", "y0", "k1", "k2", "p1", "p2", "k3")
# Parameters of both devices, the rotation between them, and the direction of the translation.
COLUMNS = (*(f"{name}_c" for name in _DEVICE), *(f"{name}_p" for name in _DEVICE), "R1", "R2", "R3", "t1", "t2")
_FOUR = [CAMERA.start, PROJECTOR.start, PROJECTOR.start + 1, PROJECTOR.start + 2]


def deviations(found: SelfCalibration, truth: Calibration) -> Floats:
    """(21,): errors in sigmas along each of the `COLUMNS`, NaN for known parameters."""
    assert found.uncertainty is not None
    true = State(device_of(truth.camera), device_of(truth.projector), truth.pose.in_baselines)
    variance = np.diag(found.uncertainty.covariance)
    distance: Floats = found.uncertainty.rig.step_to(true) / np.sqrt(np.where(variance > 0, variance, np.nan))
    return distance


def rms_of_columns(of_captures: Floats) -> str:
    """Root mean square over captures (N, 21): of f_c, f_p, x_p and y_p together, then of each column."""
    each = np.sqrt(np.nanmean(np.square(of_captures), axis=0))
    numbers = (f"{value:5.2f}" if np.isfinite(value) else f"{'–':>5}" for value in each)
    return f"{np.sqrt(np.mean(np.square(of_captures[:, _FOUR]))):5.2f} {' '.join(numbers)}"
