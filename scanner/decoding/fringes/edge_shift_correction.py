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

from calib.numerics import Bools, Floats32, Image, compiled

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


def shading_shift(
    value: Floats32, log_amplitude: Floats32, usable: Bools, footprint: Footprint, unknown: float = 0.0
) -> Floats32:
    """Return ∇x · V ∇ ln A (H, W), by central differences; `unknown` along the border and beside unusable pixels."""
    shift = np.full_like(value, unknown)
    across, down, mixed = (np.float32(v / 4) for v in (footprint.across_px2, footprint.down_px2, footprint.mixed_px2))
    _multiply_slopes(value, log_amplitude, surrounded(usable, CROSS), across, down, mixed, shift)
    return shift


@compiled
def _multiply_slopes(
    value: Floats32,
    log_amplitude: Floats32,
    chosen: Bools,
    across: np.float32,
    down: np.float32,
    mixed: np.float32,
    shift: Floats32,
) -> None:
    """Compute, at chosen pixels (H, W), none of them on the border, the products of the differences of neighbours."""
    height, width = value.shape
    for row in range(1, height - 1):
        above, here, below, is_chosen = value[row - 1], value[row], value[row + 1], chosen[row]
        log_above, log_here, log_below = log_amplitude[row - 1], log_amplitude[row], log_amplitude[row + 1]
        into = shift[row]
        for i in range(1, width - 1):
            right, lower = here[i + 1] - here[i - 1], below[i] - above[i]
            log_right, log_lower = log_here[i + 1] - log_here[i - 1], log_below[i] - log_above[i]
            total = right * (across * log_right + mixed * log_lower) + lower * (down * log_lower + mixed * log_right)
            into[i] = total if is_chosen[i] else into[i]
