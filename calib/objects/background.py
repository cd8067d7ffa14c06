"""What rests while a thing is turned before a rig that rests, too: table, cloth, wall, and what is round like a plate.

What rests is behind, and is seen at one depth in many of the stations.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

FEWEST = 4  # stations, below which chance agrees as well
_SHARE = 0.3  # of the stations that see anything at a pixel
_QUANTILE = 0.85  # of their depths: within the farthest third
_WITHIN, _SIGMAS = 3e-4, 5.0  # of the depth, and of the noise, that depths are apart for being one
_OPENED = 5  # pixels


def resting_depth(depths: Sequence[NDArray[np.float32]], noise: Sequence[float]) -> NDArray[np.float32]:
    """Depths (H, W) of what rests, 0 elsewhere, from the stations' (H, W), NaN where there is nothing.

    `noise`: standard deviation of a depth z is `noise` · z². All 0 for fewer stations than can tell.
    """
    if len(depths) < FEWEST:
        return np.zeros_like(depths[0])
    stack = np.stack(depths)
    seen = np.count_nonzero(np.isfinite(stack), axis=0)
    order = np.sort(stack, axis=0)  # NaN last
    index = np.floor(_QUANTILE * np.maximum(seen - 1, 0)).astype(np.int64)
    far = np.take_along_axis(order, index[None], axis=0)[0]
    near = within(stack, far, float(np.median(noise)))
    agreeing = np.count_nonzero(near, axis=0)
    rests = (agreeing >= np.maximum(_SHARE * seen, FEWEST - 1)) & (seen >= _SHARE * len(depths))
    square = np.ones((_OPENED, _OPENED), np.uint8)
    opened = cv2.morphologyEx(rests.astype(np.uint8), cv2.MORPH_OPEN, square) > 0
    mean = np.sum(np.where(near, stack, 0), axis=0) / np.maximum(agreeing, 1)
    return np.where(opened, mean, 0).astype(np.float32)


def within(depth: NDArray[np.float32], rest: NDArray[np.float32], noise: float) -> NDArray[np.bool_]:
    """Where a depth is that of what rests, and not of something before it."""
    with np.errstate(invalid="ignore"):
        found: NDArray[np.bool_] = np.abs(depth - rest) < rest * (_WITHIN + _SIGMAS * noise * rest)
    return found
