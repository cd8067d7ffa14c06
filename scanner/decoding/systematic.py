"""Errors that noise does not explain, from how much the fringes of different periods disagree.

Light that a neighbouring face reflects shifts a fringe. Fringes of two periods are shifted differently, so that what
separates them beyond their noise, averaged over a window, is the size of this error; likewise for whatever else depends
on the period, such as what harmonics leave.
"""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from calib.arrays import Bools
from scanner.decoding.arrays import Floats32

WINDOW_PX = 9
# Some errors are the same share of every period, like the ripple of a bent curve; reflected light fades faster than the
# period shortens, like λ² close to a crease and λ³ far from it. In between, the variance grows with the cube.
_POWER = 3
# Both periods are drawn to the same side where the crease is near: their difference shows less than the errors are.
_HIDDEN = 1.6


def systematic_variances(
    periods: Sequence[float], coordinates: Sequence[Floats32], variances: Sequence[Floats32], usable: Bools
) -> list[Floats32]:
    """Per fringe, the variance (H, W) of its coordinate beyond the noise, from `usable` pixels in windows around each.

    `variances`: those of the noise. Of a single fringe nothing is known, and its are zero.
    """
    found = [np.zeros(usable.shape, np.float32) for _ in periods]
    count = _box(usable.astype(np.float32))
    np.maximum(count, np.float32(1), out=count)
    for i, j in pairwise(range(len(periods))):
        excess = coordinates[i] - coordinates[j]
        excess *= excess
        excess -= variances[i]
        excess -= variances[j]
        excess *= usable
        mean = _box(excess)
        mean /= count
        np.maximum(mean, np.float32(0), out=mean)
        powers = np.array([periods[i], periods[j]]) ** _POWER
        for k, share in zip((i, j), _HIDDEN * powers / powers.sum(), strict=True):
            np.maximum(found[k], np.float32(share) * mean, out=found[k])
    return found


def _box(values: Floats32) -> Floats32:
    size = (WINDOW_PX, WINDOW_PX)
    return np.asarray(cv2.boxFilter(values, cv2.CV_32F, size, normalize=False, borderType=cv2.BORDER_CONSTANT))
