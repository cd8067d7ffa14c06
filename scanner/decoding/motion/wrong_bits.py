"""Detection of wrong bits from the coordinates: a moving shadow flips bits that have no inverse to check them."""

from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, Floats32, median
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import BROKEN, MaskReason
from scanner.decoding.motion.cycles import in_wrong_cycles
from scanner.decoding.motion.inconsistent_pixels import patches
from scanner.decoding.motion.light_arithmetic import RESTING
from scanner.decoding.samples import GridSample
from scanner.decoding.sequence_plan import SequencePlan

# Neighbours on a surface are not farther apart than this many cells, nor this many times the usual distance.
_FAR_CELLS, _TIMES_USUAL = 1.4, 4.0


def mask_wrong_bits(plan: SequencePlan, maps: Maps, moved: Bools | None) -> None:
    """Mask, in place, pixels with wrong bits; `moved` (H, W): where something is known to have moved, or None.

    With fringes, these are the pixels with a period slip relative to their surface. With codes alone, they are patches
    whose pixels are inconsistent or jump, unless such patches cover most of the picture.
    """
    wrong = in_wrong_cycles(plan, maps) if plan.fringes else _in_broken_patches(plan, maps)
    wrong &= maps.reason != MaskReason.DARK
    maps.reason[wrong] = np.uint8(MaskReason.MOVED)
    # Isolated pixels on the border of another period would look like a code that does not belong to the fringes.
    near = cv2.dilate(wrong.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=2) > 0
    maps.projector_px[wrong | (maps.reason != MaskReason.KEPT) & (near if moved is None else near | moved)] = np.nan


def _in_broken_patches(plan: SequencePlan, maps: Maps) -> Bools:
    grid = GridSample((maps.reason.shape[0], maps.reason.shape[1]))
    reason = grid.of(maps.reason)
    broken = np.isin(reason, BROKEN) | _jumps(plan, grid, maps)
    lit = broken | (reason == MaskReason.KEPT)
    found = patches(broken, lit)
    if np.count_nonzero(lit & ~found) < RESTING * np.count_nonzero(lit):
        return np.zeros_like(maps.reason, np.bool_)
    return grid.at_full_size(found)


def _jumps(plan: SequencePlan, grid: GridSample, maps: Maps) -> Bools:
    """Return pixels of the grid (h, w) that are farther from their neighbour than cells explain.

    Pixels on a steep surface are not counted, whose steps are all alike.
    """
    found = np.zeros(grid.of(maps.reason).shape, np.bool_)
    for number, axis in enumerate(plan.axes):
        value = cast(Floats32, grid.of(maps.projector_px[..., number]))
        for jumps, at in ((found, value), (found.T, value.T)):
            steps = np.diff(at, axis=0)
            far = _is_far(np.abs(steps), axis.cell) & _is_far(_step_change(steps), axis.cell)
            jumps[:-1] |= far
            jumps[1:] |= far
    return found


def _is_far(distance: Floats32, cell: float) -> Bools:
    """Return which distances (h, w) are far; NaN, unknown, is not."""
    known = np.isfinite(distance)
    usual = median(distance[known]) if known.any() else 0.0
    return known & (distance > max(_FAR_CELLS * cell, _TIMES_USUAL * usual))


def _step_change(steps: Floats32) -> Floats32:
    """Return the difference of each step (h, w) between rows from the more similar one of the steps before and after
    it.

    It is the step itself if both are unknown, and NaN if the step is.
    """
    others = np.full((2, *steps.shape), np.nan, np.float32)
    others[0, 1:], others[1, :-1] = steps[:-1], steps[1:]
    result: Floats32 = np.fmin(*np.abs(steps - others))
    return np.where(np.isnan(result), np.abs(steps), result)
