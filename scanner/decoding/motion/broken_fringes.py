"""Fringes that a bump of several pixels has broken in two: more than a fit to first order can follow.

Frames before and after a bump are one fringe that jumps, by the same part of a period all over a part of the image.
Exchanged and copied frames are no such thing: no jump makes a fringe of them, or one of a whole step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.numerics import Bools, Floats, Ints
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.tile_sample import TileSample
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, Fringe, SequencePlan
from scanner.decoding.significance import FEWEST_PIXELS, SIGNIFICANT_SIGMAS

_JUMPS = 33
# Farther than a knock throws a picture.
_LARGEST_PX = 15.0
# Jumps differ from face to face, but not from block to block: length of the mean of unit vectors.
_ALIKE = 0.8
_BLOCK_TILES = 4
_FEWEST_BLOCKS = 4
# The share of a fringe's power that its fit leaves over: harmonics of a gamma of 2.2 make 0.05.
_MOST_LEFT = 0.12
_OF_BEFORE = 0.12
# A jump of a whole step, to so many cycles, is a frame that was taken for the next.
_STEP_CYCLES = 0.02


@dataclass(frozen=True)
class _Taken:
    """Of a fringe: `levels` (N, P) of pixels in `block` (P,), the frames' `times` and `shifts` (N,), and
    its `period` in px."""

    levels: Floats
    block: Ints
    times: Ints
    shifts: Floats
    period: float

    def left(self, first_after: int) -> tuple[float, float]:
        """The share of the power that is left over if it jumps before the frame `first_after`, and the jump in cycles;
        on average over blocks of the image, by the best jump of each.
        """
        after = self.times >= first_after
        largest = min(0.5, _LARGEST_PX / self.period) if 0 < after.sum() < len(after) else 0.0
        jumps = np.linspace(-largest, largest, _JUMPS) if largest else np.zeros(1)
        power = np.maximum(np.sum((self.levels - self.levels.mean(axis=0)) ** 2, axis=0), 1e-9)
        count = np.bincount(self.block)
        big = count >= FEWEST_PIXELS
        left = np.stack(
            [
                np.bincount(
                    self.block, np.sum((_beside(self.shifts + jump * after) @ self.levels) ** 2, axis=0) / power
                )
                for jump in jumps
            ]
        )[:, big]
        best = np.argmin(left, axis=0)
        common = np.mean(np.exp(2j * np.pi * jumps[best]))
        if abs(common) < _ALIKE:
            return 1.0, 0.0
        return float(np.mean(left[best, np.arange(len(best))] / count[big])), float(np.angle(common)) / (2 * np.pi)


def broken_between(plan: SequencePlan, tiles: TileSample, noise: NoiseModel) -> tuple[int, int] | None:
    """The frames between which a bump explains fringes that are none otherwise; None if none does."""
    if not plan.fringes or any(len(fringe.frames) <= COSINE_PARAMETERS for fringe in plan.fringes) or not tiles.count:
        return None
    taken = [_taken(plan, fringe, tiles, noise) for fringe in plan.fringes]
    if any(np.count_nonzero(np.bincount(one.block) >= FEWEST_PIXELS) < _FEWEST_BLOCKS for one in taken):
        return None
    times = sorted({int(time) for one in taken for time in one.times})
    before = max(left for left, _ in (one.left(times[0]) for one in taken))
    found = min(((*_worst(taken, second), first, second) for first, second in pairwise(times)), key=lambda one: one[0])
    left, is_step, *frames = found
    if is_step or left > min(_MOST_LEFT, _OF_BEFORE * before):
        return None
    first, second = (plan.repeats * frame for frame in frames)
    return first, second


def _worst(taken: Sequence[_Taken], first_after: int) -> tuple[float, bool]:
    """What is left of the worst fringe, and whether all that jump do so by a whole step."""
    each = [(one, *one.left(first_after)) for one in taken]
    jumps = [
        abs(jump * len(one.shifts) - np.rint(jump * len(one.shifts))) / len(one.shifts) < _STEP_CYCLES
        for one, _, jump in each
        if one.times.min() < first_after <= one.times.max()
    ]
    return max(left for _, left, _ in each), all(jumps)


def _beside(shifts: Floats) -> Floats:
    """Takes levels (N, P) to what no offset, amplitude and phase at these shifts (N,) explain, (N, N)."""
    design = np.stack([np.ones(len(shifts)), np.cos(2 * np.pi * shifts), np.sin(2 * np.pi * shifts)], axis=1)
    rest: Floats = np.eye(len(shifts)) - design @ np.linalg.pinv(design)
    return rest


def _taken(plan: SequencePlan, fringe: Fringe, tiles: TileSample, noise: NoiseModel) -> _Taken:
    shown = [
        (shift, time)
        for shift, frame in zip(fringe.shifts, fringe.frames, strict=True)
        for time, number in enumerate(plan.shown)
        if number == frame
    ]
    times = np.array([time for _, time in shown])
    levels = tiles.levels(times.tolist(), np.arange(len(tiles.tile))).astype(np.float64)
    mean = levels.mean(axis=0)
    seen: Bools = np.mean((levels - mean) ** 2, axis=0) > SIGNIFICANT_SIGMAS**2 * noise.variance(mean)
    down, across = (tiles.camera_px[seen] // _of_block(tiles)).astype(np.int64).T[::-1]
    _, block = np.unique(down * (1 + across.max(initial=0)) + across, return_inverse=True)
    return _Taken(levels[:, seen], block.reshape(-1), times, np.array([shift for shift, _ in shown]), fringe.period)


def _of_block(tiles: TileSample) -> Floats:
    """The size of a block in camera px, (2,)."""
    size: Floats = np.maximum(np.array(tiles.shape[::-1]) / 24.0, 10.0) * _BLOCK_TILES
    return size
