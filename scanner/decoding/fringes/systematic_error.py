"""Estimate systematic phase errors from the disagreement of fringes of different periods.

Interreflection shifts a fringe by an amount that depends on its period. So the disagreement of two periods beyond their
noise, averaged over a window, measures this error; likewise any other error that depends on the period, such as
harmonics or the rounding of the pattern to grey levels.

The mean disagreement over a window is mostly an error of the longer fringe, so it is subtracted from that one. The
longer fringe then reduces the noise of a coordinate without adding an error that thousands of pixels share and that no
averaging would remove.
"""

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, Floats32, compiled
from scanner.decoding.sequence_plan import Fringe
from scanner.decoding.significance import NEGLIGIBLE
from scanner.patterns import Axis, Phase

# Windows are 3 × 3 blocks.
BLOCK_PX = 2
# Some errors are proportional to the period, like gamma ripple; interreflection falls off faster, like λ² close to a
# crease and λ³ far from it. As a compromise the variance grows with the cube.
_POWER = 3
# Close to a crease both periods are shifted to the same side: their difference is smaller than the errors.
_HIDDEN = 1.6
_ZERO, _QUARTER, _THREE_QUARTERS, _ONE = (np.float32(number) for number in (0, 0.25, 0.75, 1))
# Smooth error: standard deviation of each mode in `calib.refinement.Shifts`, for fringes of 6.7 px in simulated rooms
# (benchmarks/bench_furnished.py). It grows with the period as interreflection does.
SMOOTH_PX, _SMOOTH_PERIOD_PX = 2.5e-4, 6.7
_SMOOTH_POWER = 2


def smooth_error_px(fringes: Iterable[Fringe | Phase]) -> float:
    """Return the smooth error of coordinates from these fringes, as in `calib.refinement.Shifts`, in projector pixels.

    It is that of the shortest period of each axis, and of the axis where this is longer. Fringes may be repeated.
    """
    shortest: dict[Axis, float] = {}
    for fringe in fringes:
        shortest[fringe.axis] = min(fringe.period, shortest.get(fringe.axis, fringe.period))
    return SMOOTH_PX * (max(shortest.values(), default=_SMOOTH_PERIOD_PX) / _SMOOTH_PERIOD_PX) ** _SMOOTH_POWER


def correct_systematic(
    periods: Sequence[float], coordinates: Floats32, variances: Floats32, usable: Bools, shape: tuple[int, int]
) -> None:
    """Align the longer fringes with the shortest in the local mean, and add the systematic error to `variances`; in
    place.

    At least two fringes, longest first, `coordinates` and `variances` (fringes, P) and `usable` (P,) of an image of
    `shape` (H, W).
    """
    pairs = []
    for k in range(len(coordinates) - 1):
        images = (part.reshape(shape) for part in (*coordinates[k : k + 2], *variances[k : k + 2], usable))
        pairs.append(_apart(*images))
    powers = np.array(periods, np.float32) ** _POWER
    shares = np.float32(_HIDDEN) / (powers[:-1] + powers[1:])
    excesses = [share * np.maximum(excess, _ZERO) for share, (excess, _) in zip(shares, pairs, strict=True)]
    for k, (power, variance) in enumerate(zip(powers, variances, strict=True)):
        # Each fringe has two neighbouring periods, except the first and the last, which have one.
        _add_between(power * reduce(np.maximum, excesses[max(k - 1, 0) : k + 1]), variance.reshape(shape))
    apart = _ZERO
    for coordinate, (_, distance) in reversed([*zip(coordinates[:-1], pairs, strict=True)]):
        apart = apart - distance
        _add_between(apart, coordinate.reshape(shape))


def _apart(
    longer: Floats32, shorter: Floats32, longer_variance: Floats32, shorter_variance: Floats32, usable: Bools
) -> tuple[Floats32, Floats32]:
    """Return the excess of the squared distance of two fringes over the noise, and the distance; (H, W) → window means,
    one per block.
    """
    blocks = np.empty((3, *(-(-size // BLOCK_PX) for size in usable.shape)), np.float32)
    _compare(longer, shorter, longer_variance, shorter_variance, usable, *blocks)
    excess, distance, share = (_over_windows(part) for part in blocks)
    np.maximum(share, np.float32(NEGLIGIBLE), out=share)  # a window without usable pixels is not used
    return excess / share, distance / share


@compiled
def _compare(
    longer: Floats32,
    shorter: Floats32,
    longer_variance: Floats32,
    shorter_variance: Floats32,
    usable: Bools,
    excess: Floats32,
    distance: Floats32,
    share: Floats32,
) -> None:
    """Average over blocks the distance of two fringes (H, W), its square's excess over the noise, and the `share` of
    usable pixels.

    Unusable pixels and pixels beyond the image count as zero.
    """
    height, width = usable.shape
    of_row = np.zeros((3, 2 * share.shape[1]), np.float32)
    of_excess, of_distance, of_usable = of_row[0], of_row[1], of_row[2]
    for block in range(share.shape[0]):
        of_row[:] = _ZERO
        for row in range(2 * block, min(2 * block + 2, height)):
            of_longer, of_shorter, chosen = longer[row], shorter[row], usable[row]
            of_one, of_other = longer_variance[row], shorter_variance[row]
            for i in range(width):
                apart = of_longer[i] - of_shorter[i]
                beyond = apart * apart - of_one[i] - of_other[i]
                of_excess[i] += beyond if chosen[i] else _ZERO
                of_distance[i] += apart if chosen[i] else _ZERO
                of_usable[i] += _ONE if chosen[i] else _ZERO
        for i in range(share.shape[1]):
            excess[block, i] = _QUARTER * (of_excess[2 * i] + of_excess[2 * i + 1])
            distance[block, i] = _QUARTER * (of_distance[2 * i] + of_distance[2 * i + 1])
            share[block, i] = _QUARTER * (of_usable[2 * i] + of_usable[2 * i + 1])


def _over_windows(blocks: Floats32) -> Floats32:
    """Average the block means over windows, with zeros beyond the image."""
    return cast(Floats32, cv2.blur(blocks, (3, 3), borderType=cv2.BORDER_CONSTANT))


@compiled
def _add_between(blocks: Floats32, image: Floats32) -> None:
    """Add the window means to an image (H, W), interpolated between the centres of 2 × 2 blocks, with the border
    replicated.
    """
    height, width = image.shape
    last_row, last = blocks.shape[0] - 1, blocks.shape[1] - 1
    between = np.empty(last + 3, np.float32)
    pair = np.empty(2 * last + 2, np.float32)
    for row in range(height):
        near = row // 2
        far = min(near + 1, last_row) if row % 2 else max(near - 1, 0)
        of_near, of_far, into = blocks[near], blocks[far], image[row]
        for i in range(last + 1):
            between[i + 1] = _THREE_QUARTERS * of_near[i] + _QUARTER * of_far[i]
        between[0], between[last + 2] = between[1], between[last + 1]
        for i in range(last + 1):
            middle = _THREE_QUARTERS * between[i + 1]
            pair[2 * i] = middle + _QUARTER * between[i]
            pair[2 * i + 1] = middle + _QUARTER * between[i + 2]
        for i in range(width):
            into[i] += pair[i]
