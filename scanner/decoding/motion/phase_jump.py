"""Detection of bumps of several pixels, which are too large for a fit that is linear in the motion.

The frames before and after a bump belong to one fringe whose phase jumps by the same amount over a whole part of the
image. Exchanged or duplicated frames are different: no phase jump turns them into a fringe, or only a jump of a whole
phase step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.numerics import Bools, Floats, Ints
from scanner.decoding.light import NoiseModel
from scanner.decoding.motion.pixels import ObservedFringes
from scanner.decoding.samples import MOST_ALONG, TILE_PX, TileSample
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, Fringe, SequencePlan
from scanner.decoding.significance import AS_GOOD, FEW, FEWEST_PIXELS, SIGNIFICANT_SIGMAS

_JUMPS = 33  # to try, within half a period on either side
_BLOCK_TILES, _FEWEST_BLOCKS = 4, 4  # side of a block; blocks without which their agreement means nothing


@dataclass(frozen=True)
class _FringeSample:
    """The frames of one fringe at P pixels."""

    levels: Floats
    """(N, P): grey levels."""
    block: Ints
    """(P,): of the image."""
    times: Ints
    """(N,): of the frames."""
    shifts: Floats
    """(N,): of the phase, in cycles."""

    def fit_jump(self, first_after: int) -> tuple[float, float]:
        """Fit a phase jump before frame `first_after`: the unexplained share of the power, and the jump in cycles.

        Each block of the image takes its best jump; the result is the mean over blocks.
        """
        after = self.times >= first_after
        jumps = np.linspace(-0.5, 0.5, _JUMPS) if 0 < after.sum() < len(after) else np.zeros(1)
        power = np.maximum(np.sum((self.levels - self.levels.mean(axis=0)) ** 2, axis=0), 1e-9)
        count = np.bincount(self.block)
        big = count >= FEWEST_PIXELS
        unexplained = (_residual_projection(self.shifts + jump * after) @ self.levels for jump in jumps)
        remaining = np.stack([np.bincount(self.block, np.sum(rest**2, axis=0) / power) for rest in unexplained])[:, big]
        best = np.argmin(remaining, axis=0)
        common = np.mean(np.exp(2j * np.pi * jumps[best]))
        # Jumps differ between surfaces, but agree between blocks.
        if abs(common) < AS_GOOD:
            return 1.0, 0.0
        return float(np.mean(remaining[best, np.arange(len(best))] / count[big])), float(np.angle(common)) / (2 * np.pi)


def find_phase_jump(fringes: ObservedFringes) -> tuple[int, int] | None:
    """Return the two frames between which a bump explains fringes that fit no cosine otherwise, or None."""
    plan, tiles = fringes.plan, fringes.tiles
    if not plan.fringes or any(len(fringe.frames) <= COSINE_PARAMETERS for fringe in plan.fringes) or not tiles.count:
        return None
    samples = [_fringe_sample(plan, fringe, tiles, fringes.noise) for fringe in plan.fringes]
    if any(np.count_nonzero(np.bincount(sample.block) >= FEWEST_PIXELS) < _FEWEST_BLOCKS for sample in samples):
        return None
    times = sorted({int(time) for sample in samples for time in sample.times})
    before = max(remaining for remaining, _ in (sample.fit_jump(times[0]) for sample in samples))
    best = min(
        ((*_worst(samples, second), first, second) for first, second in pairwise(times)),
        key=lambda candidate: candidate[0],
    )
    remaining, is_step, *frames = best
    # Harmonics of a gamma of 2.2 leave 0.05 of a fringe's power.
    if is_step or remaining > FEW * min(1, before):
        return None
    first, second = (plan.repeats * frame for frame in frames)
    return first, second


def _worst(samples: Sequence[_FringeSample], first_after: int) -> tuple[float, bool]:
    """Return the unexplained power of the worst fringe, and whether all jumps are by a whole phase step, as if
    frames were taken for the next ones.
    """
    fits = [(sample, *sample.fit_jump(first_after)) for sample in samples]
    jumps = [
        abs(jump * len(sample.shifts) - np.rint(jump * len(sample.shifts))) / len(sample.shifts) < 1 / _JUMPS
        for sample, _, jump in fits
        if sample.times.min() < first_after <= sample.times.max()
    ]
    return max(remaining for _, remaining, _ in fits), all(jumps)


def _residual_projection(shifts: Floats) -> Floats:
    """Return the projection (N, N) of levels onto what no offset, amplitude and phase at these shifts (N,) explain."""
    design = np.stack([np.ones(len(shifts)), np.cos(2 * np.pi * shifts), np.sin(2 * np.pi * shifts)], axis=1)
    rest: Floats = np.eye(len(shifts)) - design @ np.linalg.pinv(design)
    return rest


def _fringe_sample(plan: SequencePlan, fringe: Fringe, tiles: TileSample, noise: NoiseModel) -> _FringeSample:
    times, shifts = plan.times_of(fringe)
    levels = tiles.of_frames(times.tolist()).astype(np.float64)
    mean = levels.mean(axis=0)
    visible: Bools = np.mean((levels - mean) ** 2, axis=0) > SIGNIFICANT_SIGMAS**2 * noise.variance(mean)
    side = np.maximum(np.array(tiles.shape[::-1]) / MOST_ALONG, TILE_PX) * _BLOCK_TILES
    across, down = (tiles.camera_px[visible] // side).astype(np.int64).T
    block = np.unique(down * (1 + across.max(initial=0)) + across, return_inverse=True)[1]
    return _FringeSample(levels[:, visible], block.reshape(-1), times, shifts)
