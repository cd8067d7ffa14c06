"""Errors that noise does not explain, from how much the fringes of different periods disagree.

Light that a neighbouring face reflects shifts a fringe. Fringes of two periods are shifted differently, so that what
separates them beyond their noise, averaged over a window, is the size of this error; likewise for whatever else depends
on the period, such as what harmonics or the rounding of the pattern to grey levels leave.

The mean distance over a window is mostly an error of the longer fringe, so it is taken out of that one: what a longer
fringe adds to a coordinate is less noise, not its error, which is the same at thousands of pixels and would stay in
every mean over them.
"""

from collections.abc import Iterable, Sequence
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, compiled
from scanner.decoding.arrays import Floats32
from scanner.decoding.sequence_plan import Fringe
from scanner.patterns import Axis, Phase

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
# What stays in every mean: the standard deviation of each of its modes, as of `calib.refinement.Shifts`, for fringes of
# 6.7 px in simulated rooms (benchmarks/bench_furnished.py). With longer ones it grows as interreflection does.
SMOOTH_PX, _SMOOTH_PERIOD_PX = 2.5e-4, 6.7
_SMOOTH_POWER = 2


def smooth_error_px(fringes: Iterable[Fringe | Phase]) -> float:
    """What coordinates by such fringes err smoothly, as of `calib.refinement.Shifts`, in projector pixels.

    By the shortest of either axis, and of the two axes by the longer one; fringes may be there several times.
    """
    shortest: dict[Axis, float] = {}
    for fringe in fringes:
        shortest[fringe.axis] = min(fringe.period, shortest.get(fringe.axis, fringe.period))
    return SMOOTH_PX * (max(shortest.values(), default=_SMOOTH_PERIOD_PX) / _SMOOTH_PERIOD_PX) ** _SMOOTH_POWER


def correct_systematic(
    periods: Sequence[float], coordinates: Floats32, variances: Floats32, usable: Bools, shape: tuple[int, int]
) -> None:
    """Bring two fringes or more, longest first, to the mean of the shortest around each pixel, and add to each one's
    `variances` (fringes, P) that of its coordinate beyond the noise; in place.

    From the `coordinates` (fringes, P) of `usable` pixels (P,) in windows around each, in an image of `shape` (H, W).
    """
    share: Floats32 = np.maximum(_coarse(usable.reshape(shape).astype(np.float32)), _FEWEST)

    def mean(values: Floats32) -> Floats32:
        return cast(Floats32, _coarse(values.reshape(shape)) / share)

    excess, distance = np.empty((2, len(usable)), np.float32)
    excesses, distances = [], []
    for k in range(len(coordinates) - 1):
        _compare(coordinates[k], coordinates[k + 1], variances[k], variances[k + 1], usable, excess, distance)
        excesses.append(_fine(np.maximum(mean(excess), _ZERO), shape))
        distances.append(_fine(mean(distance), shape))
    _bring_together(coordinates, distances)
    powers = np.array(periods) ** _POWER
    of_longer, of_shorter = (_HIDDEN * part / (powers[:-1] + powers[1:]) for part in (powers[:-1], powers[1:]))
    last = len(excesses) - 1
    for k, variance in enumerate(variances):
        # Of what a fringe is apart from that before and that after it, the first and the last have one only.
        before = (excesses[k - 1], of_shorter[k - 1]) if k > 0 else (excesses[0], of_longer[0])
        after = (excesses[k], of_longer[k]) if k <= last else (excesses[last], of_shorter[last])
        _add_larger(before[0], np.float32(before[1]), after[0], np.float32(after[1]), variance)


def _bring_together(coordinates: Floats32, distances: Sequence[Floats32]) -> None:
    """Take out of each but the last how far it is from that, given the distances (P,) between every two successive."""
    apart = np.zeros_like(coordinates[0])
    for coordinate, distance in reversed([*zip(coordinates[:-1], distances, strict=True)]):
        apart += distance
        coordinate -= apart


@compiled
def _compare(
    longer: Floats32,
    shorter: Floats32,
    longer_variance: Floats32,
    shorter_variance: Floats32,
    usable: Bools,
    excess: Floats32,
    distance: Floats32,
) -> None:
    """How far usable pixels of one fringe are from those of another, and by how much the square exceeds the noise."""
    for i in range(len(excess)):
        apart = longer[i] - shorter[i]
        beyond = apart * apart - longer_variance[i] - shorter_variance[i]
        excess[i] = beyond if usable[i] else _ZERO
        distance[i] = apart if usable[i] else _ZERO


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


def _fine(blocks: Floats32, shape: tuple[int, int]) -> Floats32:
    """Means over windows, one for each pixel (P,)."""
    height, width = shape
    fine = cv2.resize(blocks, (width + width % BLOCK_PX, height + height % BLOCK_PX))
    return cast(Floats32, np.ascontiguousarray(fine[:height, :width]).reshape(-1))
