"""Errors that noise does not explain, from how much the fringes of different periods disagree.

Light that a neighbouring face reflects shifts a fringe. Fringes of two periods are shifted differently, so that what
separates them beyond their noise, averaged over a window, is the size of this error; likewise for whatever else depends
on the period, such as what harmonics leave.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import cv2
import numpy as np

from calib.arrays import Bools
from scanner.decoding.arrays import Floats32

# Windows are 3 × 3 blocks.
BLOCK_PX = 2
# Share of a window's pixels; a window with none is not asked for.
_FEWEST = 0.01
# Some errors are the same share of every period, like the ripple of a bent curve; reflected light fades faster than the
# period shortens, like λ² close to a crease and λ³ far from it. In between, the variance grows with the cube.
_POWER = 3
# Both periods are drawn to the same side where the crease is near: their difference shows less than the errors are.
_HIDDEN = 1.6


def systematic_variances(
    periods: Sequence[float], coordinates: Sequence[Floats32], variances: Sequence[Floats32], usable: Bools
) -> list[Floats32]:
    """Per fringe, the variance (H, W) of its coordinate beyond the noise, from `usable` pixels in windows around each.

    `variances`: those of the noise. Of a single fringe nothing is known, and its is zero, (1, 1).
    """
    found = [np.zeros((1, 1), np.float32) for _ in periods]
    weight = _coarse(usable.astype(np.float32))
    np.maximum(weight, np.float32(_FEWEST), out=weight)
    there = usable.astype(np.float32)
    for i, j in pairwise(range(len(periods))):
        excess = coordinates[i] - coordinates[j]
        excess *= excess
        excess -= variances[i]
        excess -= variances[j]
        excess *= there
        mean = np.maximum(_coarse(excess) / weight, np.float32(0))
        powers = np.array([periods[i], periods[j]]) ** _POWER
        for k, share in zip((i, j), _HIDDEN * powers / powers.sum(), strict=True):
            fine = cast(Floats32, cv2.resize(np.float32(share) * mean, usable.shape[::-1]))
            found[k] = np.maximum(found[k], fine, out=fine)
    return found


def _coarse(image: Floats32) -> Floats32:
    """Means over windows, one for each block of pixels."""
    height, width = (-(-size // BLOCK_PX) for size in image.shape)
    blocks = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return cast(Floats32, cv2.blur(blocks, (3, 3), borderType=cv2.BORDER_CONSTANT))
