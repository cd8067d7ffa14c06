"""Errors that noise does not explain, from how much the fringes of different periods disagree.

Light that a neighbouring face reflects shifts a fringe. Fringes of two periods are shifted differently, so that what
separates them beyond their noise, averaged over a window, is the size of this error; likewise for whatever else depends
on the period, such as what harmonics leave.
"""

from collections.abc import Sequence
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, compiled
from scanner.decoding.arrays import Floats32

# Windows are 3 × 3 blocks.
BLOCK_PX = 2
# Share of a window's pixels; a window with none is not asked for.
_FEWEST = np.float32(0.01)
# Some errors are the same share of every period, like the ripple of a bent curve; reflected light fades faster than the
# period shortens, like λ² close to a crease and λ³ far from it. In between, the variance grows with the cube.
_POWER = 3
# Both periods are drawn to the same side where the crease is near: their difference shows less than the errors are.
_HIDDEN = 1.6
_ZERO = np.float32(0)


def add_systematic(
    periods: Sequence[float], coordinates: Floats32, variances: Floats32, usable: Bools, shape: tuple[int, int]
) -> None:
    """Add to each fringe's `variances` (fringes, P) that of its coordinate beyond the noise, of two fringes or more.

    From the `coordinates` (fringes, P) of `usable` pixels (P,) in windows around each, in an image of `shape` (H, W).
    """
    excess = _excess_variances(coordinates, variances, usable, shape)
    powers = np.array(periods) ** _POWER
    of_longer, of_shorter = (_HIDDEN * part / (powers[:-1] + powers[1:]) for part in (powers[:-1], powers[1:]))
    last = len(excess) - 1
    for k, variance in enumerate(variances):
        # Of what a fringe is apart from that before and that after it, the first and the last have one only.
        before = (excess[k - 1], of_shorter[k - 1]) if k > 0 else (excess[0], of_longer[0])
        after = (excess[k], of_longer[k]) if k <= last else (excess[last], of_shorter[last])
        _add_larger(before[0], np.float32(before[1]), after[0], np.float32(after[1]), variance)


def _excess_variances(
    coordinates: Floats32, variances: Floats32, usable: Bools, shape: tuple[int, int]
) -> list[Floats32]:
    """By how much the squared distance (P,) between every two successive fringes exceeds the noise."""
    height, width = shape
    weight = np.maximum(_coarse(usable.reshape(shape).astype(np.float32)), _FEWEST)
    excess, whole_blocks = np.empty(shape, np.float32), (width + width % BLOCK_PX, height + height % BLOCK_PX)
    found = []
    for k in range(len(coordinates) - 1):
        _excess(coordinates[k], coordinates[k + 1], variances[k], variances[k + 1], usable, excess.reshape(-1))
        fine = cast(Floats32, cv2.resize(np.maximum(_coarse(excess) / weight, _ZERO), whole_blocks))
        found.append(fine[:height, :width].reshape(-1))
    return found


@compiled
def _excess(
    longer: Floats32,
    shorter: Floats32,
    longer_variance: Floats32,
    shorter_variance: Floats32,
    usable: Bools,
    excess: Floats32,
) -> None:
    for i in range(len(excess)):
        distance = longer[i] - shorter[i]
        beyond = distance * distance - longer_variance[i] - shorter_variance[i]
        excess[i] = beyond if usable[i] else _ZERO


@compiled
def _add_larger(
    first: Floats32, first_share: np.float32, second: Floats32, second_share: np.float32, variance: Floats32
) -> None:
    """Add the larger of two shares."""
    for i in range(len(variance)):
        variance[i] += max(first_share * first[i], second_share * second[i])


def _coarse(image: Floats32) -> Floats32:
    """Means over windows, one for each block of pixels; beyond the image is nothing."""
    height, width = image.shape
    if height % BLOCK_PX or width % BLOCK_PX:
        image = np.pad(image, ((0, height % BLOCK_PX), (0, width % BLOCK_PX)))
    blocks = cv2.resize(image, None, fx=1 / BLOCK_PX, fy=1 / BLOCK_PX, interpolation=cv2.INTER_AREA)
    return cast(Floats32, cv2.blur(blocks, (3, 3), borderType=cv2.BORDER_CONSTANT))
