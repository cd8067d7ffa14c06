"""What wrong bits leave where something moved: a shadow turns bits over that have no inverse; only coordinates tell."""

from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, median
from scanner.decoding.arrays import Floats32
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import BROKEN, MaskReason
from scanner.decoding.motion.coarse_frames import CoarseFrames
from scanner.decoding.motion.cycles import in_wrong_cycles
from scanner.decoding.motion.inconsistent_pixels import MOST, patches
from scanner.decoding.sequence_plan import SequencePlan

# How many cells neighbours are apart that are of no surface; and how much farther than most.
_FAR_CELLS, _TIMES_USUAL = 1.4, 4.0
_AROUND = np.ones((5, 5), np.uint8)


def mask_wrong_bits(plan: SequencePlan, maps: Maps, moved: Bools | None) -> None:
    """Mask, in place, what wrong bits have left, where something is known to have `moved` (H, W), or not.

    Where fringes tell the position within a cycle, those that are in another cycle than the surface around them; where
    codes are alone, patches in which pixels contradict themselves or their surface, if those are not most of all.
    """
    wrong = in_wrong_cycles(plan, maps) if plan.fringes else _in_broken_patches(plan, maps)
    wrong &= maps.reason != MaskReason.DARK
    maps.reason[wrong] = np.uint8(MaskReason.MOVED)
    # What is isolated on the border of another cycle would look like a code that is not that of the fringes.
    near = cv2.dilate(wrong.astype(np.uint8), _AROUND) > 0
    maps.projector_px[wrong | (maps.reason != MaskReason.KEPT) & (near if moved is None else near | moved)] = np.nan


def _in_broken_patches(plan: SequencePlan, maps: Maps) -> Bools:
    coarse = CoarseFrames((maps.reason.shape[0], maps.reason.shape[1]))
    reason = coarse.of(maps.reason)
    broken = np.isin(reason, BROKEN) | _jumps(plan, coarse, maps)
    lit = broken | (reason == MaskReason.KEPT)
    found = patches(broken, lit)
    if np.count_nonzero(found & lit) > MOST * np.count_nonzero(lit):
        return np.zeros_like(maps.reason, np.bool_)
    return coarse.at_full_size(found)


def _jumps(plan: SequencePlan, coarse: CoarseFrames, maps: Maps) -> Bools:
    """Pixels of the grid (h, w) that are farther from the next one than cells leave them, and not as far as the next
    ones are from each other: those of a steep surface are.
    """
    found = np.zeros(coarse.of(maps.reason).shape, np.bool_)
    for number, axis in enumerate(plan.axes):
        value = cast(Floats32, coarse.of(maps.projector_px[..., number]))
        for jumps, at in ((found, value), (found.T, value.T)):
            steps = np.diff(at, axis=0)
            far = _is_far(np.abs(steps), axis.cell) & _is_far(_beside_next(steps), axis.cell)
            jumps[:-1] |= far
            jumps[1:] |= far
    return found


def _is_far(distance: Floats32, cell: float) -> Bools:
    """(h, w), NaN where unknown; which is not far."""
    known = np.isfinite(distance)
    usual = median(distance[known]) if known.any() else 0.0
    return known & (distance > max(_FAR_CELLS * cell, _TIMES_USUAL * usual))


def _beside_next(steps: Floats32) -> Floats32:
    """By how much each step (h, w), from one row to the next, differs from the one before or after it, whichever is the
    more like it; itself, where both are unknown; NaN where it is.
    """
    others = np.full((2, *steps.shape), np.nan, np.float32)
    others[0, 1:], others[1, :-1] = steps[:-1], steps[1:]
    result: Floats32 = np.fmin(*np.abs(steps - others))
    return np.where(np.isnan(result), np.abs(steps), result)
