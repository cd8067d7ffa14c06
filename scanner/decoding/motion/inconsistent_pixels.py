"""Where the frames of a pixel contradict each other while those of other pixels do not: something moved there.

A frame that shows another pattern breaks light's arithmetic (light_arithmetic.py) all over the picture. Something that
moved, or its shadow, breaks it in patches, beside which all frames agree.
"""

from dataclasses import dataclass
from math import hypot
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools
from scanner.decoding.arrays import Floats32
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.coarse_frames import CoarseFrames
from scanner.decoding.motion.light_arithmetic import broken_fringes, contradictions, frames_of_fine_bits
from scanner.decoding.sequence_plan import SequencePlan
from scanner.decoding.significance import BRIGHTEST

# Pixels that swing less than this share of what the brightest few do are hardly lit.
_LIT = 0.1
# Every so many-th of the grid's pixels tells quickly that nothing moved: so few contradictions are no patch.
_STRIDE, _A_FEW = 3, 4
# So many of the lit pixels around one are in contradiction where something moved; its edges are lit by both.
_WINDOW, _DENSE, _ENOUGH_LIT = 9, 0.3, 0.3
_SMALLEST, _MARGIN = 30, 1
# Frames that contradict the others in so much of where something moved are those in which it did.
_MUCH_OF_IT = 0.1
# Where more than this moved, it is no thing before what rests, unless it passed: where it has left, frames agree again,
# so that a pixel contradicts itself in about one group of frames, and after a bump in many. Nor is it if the picture as
# a whole is elsewhere, in pixels of the grid.
MOST, _MOST_IN_ALL, _TRANSIENT, _MOVED_PX = 0.7, 0.97, 1.5, 0.5


@dataclass(frozen=True)
class InconsistentPixels:
    """Where something `moved` (H, W), a `share` of what is lit; and where what is lit `resting`. `frames`: those that
    contradict others where something moved. `corrupted` (H, W): where no coordinate can be had for it, which is where
    fringes changed; what changed in codes only shows in the cycles (cycles.py), if there are fringes.
    """

    moved: Bools
    corrupted: Bools
    resting: Bools
    share: float
    frames: tuple[int, ...]

    def message(self, plan: SequencePlan) -> str:
        """For the operator."""
        return (
            f"Something moved in {max(self.share, 0.01):.0%} of the lit picture, which shows in "
            f"{plan.names(self.frames)}; the affected pixels were masked, and the rest is used."
        )


def find_inconsistent_pixels(plan: SequencePlan, coarse: CoarseFrames, noise: NoiseModel) -> InconsistentPixels | None:
    """Where something moved, if it is not most of what is lit."""
    levels = coarse.levels
    swing = np.ptp(levels, axis=0)
    lit: Bools = swing > max(_LIT * float(np.quantile(swing, BRIGHTEST)), 1e-6)
    some = np.zeros_like(lit)
    some[::_STRIDE, ::_STRIDE] = lit[::_STRIDE, ::_STRIDE]
    if sum(np.count_nonzero(each) for _, each in contradictions(plan, levels[:, some], noise)) <= _A_FEW:
        return None
    groups = contradictions(plan, levels[:, lit], noise)
    off = np.zeros(lit.shape, np.bool_)
    off[lit] = np.any([each for _, each in groups], axis=0) if groups else False
    moved = patches(off, lit)
    inside = moved[lit]
    share = float(inside.mean()) if len(inside) else 0.0
    is_transient = _is_transient(groups, off[lit])
    if not 0 < share <= (_MOST_IN_ALL if is_transient else MOST):
        return None
    frames = {frame for of, each in groups if each[inside].mean() > _MUCH_OF_IT for frame in of}
    if not frames or _picture_moved(levels, [of for of, _ in groups], frames, lit & ~moved):
        return None
    if plan.fringes:
        corrupted = _corrupted(plan, levels, lit, moved, noise, is_transient=is_transient)
    else:
        corrupted = moved & (off | _in_fine_bits(plan, groups, lit)) if is_transient else moved
    resting = coarse.at_full_size(lit & ~moved & ~_dense(off, lit))
    return InconsistentPixels(
        coarse.at_full_size(moved), coarse.at_full_size(corrupted), resting, share, tuple(sorted(frames))
    )


def _is_transient(groups: list[tuple[tuple[int, ...], Bools]], off: Bools) -> bool:
    """Whether pixels that are off (P,) are so in about one of the groups of frames, which may tell in several ways."""
    times = sum(
        np.count_nonzero(np.any([each for of, each in groups if of == frames], axis=0))
        for frames in {of for of, _ in groups}
    )
    return bool(times <= _TRANSIENT * np.count_nonzero(off))


def _in_fine_bits(plan: SequencePlan, groups: list[tuple[tuple[int, ...], Bools]], lit: Bools) -> Bools:
    """Where something passed while fine bits were shown (h, w): what is wrong by few cells looks right."""
    fine, off = frames_of_fine_bits(plan), np.zeros(lit.shape, np.bool_)
    for frames, each in groups:
        if fine.intersection(frames):
            off[lit] |= each
    return patches(off, lit)


def _corrupted(
    plan: SequencePlan, levels: Floats32, lit: Bools, moved: Bools, noise: NoiseModel, *, is_transient: bool
) -> Bools:
    """Where fringes changed (h, w), pixel by pixel: one that is dark where a shadow falls does not, and stays right.

    Longer fringes than the last of an axis tell its cycle only: where something `is_transient` during one, the cycle is
    right, or does not fit, or shows beside that of its surface. What came to stay is seen by some of them only.
    """
    fringes = [axis.fringes[-1] for axis in plan.axes if axis.fringes] if is_transient else plan.fringes
    off = np.zeros(lit.shape, np.bool_)
    off[lit] = broken_fringes(plan, fringes, levels[:, lit], noise, ~moved[lit])
    near: Bools = cv2.dilate(moved.astype(np.uint8), np.ones((_WINDOW, _WINDOW), np.uint8)) > 0
    return off & near


def _picture_moved(levels: Floats32, groups: list[tuple[int, ...]], frames: set[int], resting: Bools) -> bool:
    """Whether all of the picture, `levels` (frames, h, w), is elsewhere in the `frames` that contradict the others: the
    camera moved. If it was a large thing, its way does not bring into line what `resting` (h, w).
    """
    even = [group for group in groups if len(group) > 1]
    contradicting, others = (
        [levels[list(group)].mean(axis=0) for group in even if frames.issuperset(group) == is_odd]
        for is_odd in (True, False)
    )
    if not contradicting or not others:
        return False
    window = cast(Floats32, cv2.createHanningWindow((levels.shape[2], levels.shape[1]), cv2.CV_32F))
    before, after = (np.log1p(np.stack(each).mean(axis=0)) for each in (others, contradicting))
    (right, down), _ = cv2.phaseCorrelate(before, after, window)
    if hypot(right, down) <= _MOVED_PX:
        return False
    back = np.array([[1.0, 0.0, -right], [0.0, 1.0, -down]])
    taken_back = cv2.warpAffine(after, back, after.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
    off, off_as_seen = (float(np.abs(image - before)[resting].sum()) for image in (taken_back, after))
    return off <= off_as_seen


def patches(off: Bools, lit: Bools) -> Bools:
    """Where many lit pixels around are off, (h, w), of enough, as far as they hang together, with a margin."""
    dense = _dense(off, lit) & (_count_around(lit) > _ENOUGH_LIT * _WINDOW**2)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(dense.astype(np.uint8), connectivity=8)
    large = statistics[:, cv2.CC_STAT_AREA] >= _SMALLEST
    large[0] = False
    kernel = np.ones((2 * _MARGIN + 1, 2 * _MARGIN + 1), np.uint8)
    return cast(Bools, cv2.dilate(large[labels].astype(np.uint8), kernel).astype(np.bool_))


def _dense(off: Bools, lit: Bools) -> Bools:
    """Lit pixels of which many around are off, (h, w)."""
    return (_count_around(off & lit) > _DENSE * _count_around(lit)) & lit


def _count_around(some: Bools) -> Floats32:
    """How many there are in the window around each pixel, (h, w)."""
    window = (_WINDOW, _WINDOW)
    count = cv2.boxFilter(some.astype(np.float32), -1, window, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return cast(Floats32, count)
