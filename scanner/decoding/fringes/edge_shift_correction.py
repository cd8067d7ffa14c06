"""The coordinate shift at brightness edges, caused by the average over the footprint of a camera pixel.

A camera pixel averages the fringes over its footprint, weighted by brightness, so its coordinate is biased towards the
brighter side: x is too large by ∇x · V ∇ ln A, with A the fringe's amplitude and V the footprint's covariance. (For a
Gaussian footprint this is exact: it is Tweedie's formula, Efron, JASA 106, 2011.) At the edge of a poster, a floorboard
or a shadow the bias is tenths of a pixel; where light falls off evenly over a wall it is thousandths, all over the
wall.
"""

from dataclasses import dataclass
from math import hypot

import cv2
import numpy as np

from calib.numerics import Bools, Image, compiled
from scanner.decoding.arrays import Floats32

_ZERO, _QUARTER = np.float32(0), np.float32(0.25)
CROSS = np.asarray(cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), np.uint8)


@dataclass(frozen=True)
class Footprint:
    """The covariance of a camera pixel's footprint, in square camera pixels: column variance, row
    variance, covariance.
    """

    across_px2: float
    down_px2: float
    mixed_px2: float = 0.0

    @classmethod
    def round(cls, variance_px2: float) -> "Footprint":
        """Return an isotropic footprint."""
        return cls(variance_px2, variance_px2)

    @property
    def largest_px2(self) -> float:
        """The variance along the principal axis."""
        half = (self.across_px2 - self.down_px2) / 2
        return (self.across_px2 + self.down_px2) / 2 + hypot(half, self.mixed_px2)


# Basis of all covariances.
UNITS = Footprint(1, 0), Footprint(0, 1), Footprint(0, 0, 1)


def log_amplitude(power: Floats32) -> Floats32:
    """Return the logarithm of the amplitude from its square, any shape."""
    result = np.empty_like(power)
    cv2.log(power.reshape(1, -1), result.reshape(1, -1))
    result *= np.float32(0.5)
    return result


def surrounded(usable: Bools, window: Image) -> Bools:
    """Return the pixels (H, W) around which the whole window is usable."""
    whole = cv2.erode(usable.view(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return whole.view(np.bool_)


def shading_shift(value: Floats32, log_amplitude: Floats32, usable: Bools, footprint: Footprint) -> Floats32:
    """Return ∇x · V ∇ ln A (H, W), by central differences; zero along the border and beside unusable pixels."""
    chosen = surrounded(usable, CROSS)
    shift = np.zeros_like(value)
    across, down, mixed = (np.float32(v) for v in (footprint.across_px2, footprint.down_px2, footprint.mixed_px2))
    if across:
        _add_products(value, log_amplitude, chosen, 0, 1, across, shift)
    if down:
        _add_products(value, log_amplitude, chosen, 1, 0, down, shift)
    if mixed:
        _add_mixed_products(value, log_amplitude, chosen, mixed, shift)
    return shift


@compiled
def _add_products(
    value: Floats32,
    log_amplitude: Floats32,
    chosen: Bools,
    down: int,
    across: int,
    times: np.float32,
    sums: Floats32,
) -> None:
    """Add, at chosen pixels, `times` the product of the two images' slopes along columns or along rows."""
    height, width = value.shape
    share = _QUARTER * times
    for row in range(down, height - down):
        above, left, right = row - down, width - 2 * across, 2 * across
        value_before, value_after = value[above, :left], value[row + down, right:]
        log_before, log_after = log_amplitude[above, :left], log_amplitude[row + down, right:]
        is_chosen, total = chosen[row, across : width - across], sums[row, across : width - across]
        for i in range(len(total)):
            product = (value_after[i] - value_before[i]) * (log_after[i] - log_before[i])
            total[i] += share * product if is_chosen[i] else _ZERO


@compiled
def _add_mixed_products(
    value: Floats32, log_amplitude: Floats32, chosen: Bools, times: np.float32, sums: Floats32
) -> None:
    """Add, at chosen pixels, `times` the products of one image's slope along rows and the other's along columns."""
    height, width = value.shape
    share = _QUARTER * times
    for row in range(1, height - 1):
        for i in range(1, width - 1):
            of_value = value[row, i + 1] - value[row, i - 1], value[row + 1, i] - value[row - 1, i]
            of_log = (
                log_amplitude[row, i + 1] - log_amplitude[row, i - 1],
                log_amplitude[row + 1, i] - log_amplitude[row - 1, i],
            )
            product = of_value[0] * of_log[1] + of_value[1] * of_log[0]
            sums[row, i] += share * product if chosen[row, i] else _ZERO
