"""Medians by sorting, which NumPy does with vector instructions, in half the time that its own medians take."""

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN
from scanner.decoding.arrays import Floats32


def medians(values: Floats32, axis: int) -> Floats32:
    """Along one axis of an array that is not empty along it."""
    ordered, count = np.sort(values, axis=axis), values.shape[axis]
    middle: Floats32 = np.take(ordered, (count - 1) // 2, axis) + np.take(ordered, count // 2, axis)
    return np.float32(0.5) * middle


def robust_sigmas(values: Floats32) -> Floats32:
    """(N,): the standard deviations of N samples (N, P) about their medians, outliers left aside."""
    away = np.abs(values - medians(values, axis=1)[:, None])
    return np.float32(SIGMA_PER_MEDIAN) * medians(away, axis=1)
