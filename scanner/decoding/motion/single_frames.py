"""Frames that moved on their own: each a little, as of hand-held cameras, or all from one on by several pixels.

Small motion of every frame is that of hand-held cameras and software image stabilisation. Least squares over thousands
of pixels measures the shift of each frame (`frame_equations`) from the slopes of the frames themselves: to first order,
a shift by d changes a frame I by −∇I · d, that of the fringes and that of the texture. A shift that all frames share is
unobservable.

A bump of several pixels is too large for a linear fit. The frames before and after it belong to one fringe whose phase
jumps by the same amount over a whole part of the image. Exchanged or duplicated frames are different: no phase jump
turns them into a fringe, or only a jump of a whole phase step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from math import sqrt

import numpy as np
import scipy

from calib.numerics import LEVEL, SLOPE, Bools, Floats, Floats32, Ints
from scanner.decoding.light import MOST_ALONG, TILE_PX, NoiseModel, TileSample
from scanner.decoding.motion.device_motion import MotionEstimate
from scanner.decoding.motion.frame_equations import FrameEquations, FringeFrames, FringeModel, fringe_frames, of_frames
from scanner.decoding.motion.pixels import MotionPixels, ObservedFringes
from scanner.decoding.motion.rigid_motion import COLUMNS, PER_DEVICE, CoordinateShift
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, Fringe, SequencePlan
from scanner.decoding.significance import AS_GOOD, BY_CHANCE, FEW, FEWEST_PIXELS, HALF, SIGNIFICANT_SIGMAS

# Noise reduction by the taps along both axes, as a factor of the variance.
_LESS_NOISE = float(np.sum(LEVEL**2)) ** 2
_MARGIN = len(LEVEL) // 2
# Apparent motion at rest due to ripple: of a single frame, and of the mean of the frames of a fringe.
_OF_A_FRAME_PX, _OF_A_FRINGE_PX = 0.03, 0.01
# One event explains nearly all of its effect; nonlinearity leaves a few hundredths.
_MOST_BY_EVENT = 0.95


@dataclass(frozen=True)
class FrameShifts:
    """Shifts of N frames relative to their mean."""

    times: Ints
    """(N,): places of the frames in the sequence."""
    shift_px: Floats
    """(2, N): shift of the scene to the right and down."""
    covariance: Floats
    """(2 N, 2 N)"""
    by_shifts: float
    """Share of the residuals of a fit of light alone that the shifts explain."""
    by_event: float
    """Share of this that one bump or one even drift explains."""

    @property
    def is_no_event(self) -> bool:
        """Whether the shifts are significant, and not explained by a single event."""
        if self.by_event >= _MOST_BY_EVENT:
            return False
        shifts = self.shift_px.reshape(-1)
        squared = float(shifts @ np.linalg.solve(self.covariance + _OF_A_FRAME_PX**2 * np.eye(shifts.size), shifts))
        return squared > float(scipy.special.chdtri(shifts.size - 2, BY_CHANCE))

    @property
    def are_distinct_from_light(self) -> bool:
        """Whether the shifts explain what changes of light do not, and many frames are shifted.

        A frame with ghosting of the last picture looks as if it and the opposite step were shifted. Shifts explain more
        than 0.75 of the residuals of light where frames were shifted, and less than 0.35 where flicker was left. Two of
        eight independent frames have up to half of the squares, a late frame and its opposite step 0.97.
        """
        squares = np.sort(np.sum(self.shift_px**2, axis=0))
        return self.by_shifts > HALF and float(squares[-2:].sum()) < AS_GOOD * float(squares.sum())

    def between(self, shares: Floats) -> tuple[Floats, Floats]:
        """Return the sum (2,) of shares (N,) of the shifts, and its covariance (2, 2)."""
        both = np.kron(np.eye(2), shares)
        return self.shift_px @ shares, both @ self.covariance @ both.T


def shifts_of_frames(fringes: ObservedFringes, pixels: MotionPixels, by_event: float) -> FrameShifts:
    """Measure the shifts of the frames of all fringes."""
    frames = fringe_frames(fringes.plan)
    count = len(frames.times)
    equations = equations_of_shifts(frames, fringes.tiles, pixels, fringes.noise)
    fit = equations.along(np.eye(2 * count))
    about_mean = np.kron(np.eye(2), np.eye(count) - 1 / count)
    return FrameShifts(
        frames.times,
        (about_mean @ fit.values).reshape(2, count),
        about_mean @ equations.covariance(fit) @ about_mean,
        1.0 - equations.variance(fit.values) / max(equations.variance(), 1e-12),
        by_event,
    )


def equations_of_shifts(
    frames: FringeFrames, tiles: TileSample, pixels: MotionPixels, noise: NoiseModel
) -> FrameEquations:
    """Return the equations for the shift of each frame to the right and down."""
    row, column = np.divmod(pixels.number % TILE_PX**2, TILE_PX)
    inside = (np.minimum(row, column) >= _MARGIN) & (np.maximum(row, column) < TILE_PX - _MARGIN)
    images = tiles.of_frames(frames.times.tolist())
    place = pixels.number[inside]
    levels, right, down = (
        _filtered(images, *taps)[:, place] for taps in ((LEVEL, LEVEL), (LEVEL, SLOPE), (SLOPE, LEVEL))
    )
    model = FringeModel(frames, levels.astype(np.float64))
    variance = _LESS_NOISE * noise.variance(model.light).astype(np.float64)
    return FrameEquations(frames, pixels.tile[inside], (of_frames(model, -np.stack([right, down]), variance),))


def _filtered(images: Floats32, down: Floats, across: Floats) -> Floats32:
    """Filter tiles (N, P) by taps along columns and rows; values within two pixels of a tile's border are undefined."""
    filtered = images.reshape(len(images), -1, TILE_PX, TILE_PX)
    # A matrix product of a few taps made OpenBLAS warn of invalid values that do not exist.
    for axis, taps in ((2, down), (3, across)):
        shifted = (tap * np.roll(filtered, _MARGIN - k, axis) for k, tap in enumerate(taps.astype(np.float32)))
        filtered = reduce(np.add, shifted)
    return filtered.reshape(images.shape)


def moved_one_by_one(
    event: MotionEstimate, plan: SequencePlan, shifts: FrameShifts, pixels: MotionPixels
) -> MotionEstimate:
    """Return a result for independent motion of the frames, in place of the event `values`."""
    x, y = (_shares(axis.fringes[-1], plan, shifts.times) for axis in plan.axes)
    apart, covariance = shifts.between(x - y)
    # Half of it goes to x, and half to y: their common part is equivalent to another pose of the rig.
    half = np.zeros((2, 2, COLUMNS))
    half[0, :, PER_DEVICE : PER_DEVICE + 2] = np.eye(2) / 2
    half[1] = -half[0]

    def disturbance(of: Floats) -> CoordinateShift:
        return replace(event.shift, motions=np.einsum("adc,d->ac", half, of))

    values, vectors = np.linalg.eigh(covariance + 2 * _OF_A_FRINGE_PX**2 * np.eye(2))
    spread = tuple(disturbance(sqrt(max(value, 0.0)) * vector) for value, vector in zip(values, vectors.T, strict=True))
    typical = np.zeros(COLUMNS)
    typical[PER_DEVICE : PER_DEVICE + 2] = np.sqrt(np.mean(shifts.shift_px**2, axis=1))
    return replace(
        event,
        motion=typical,
        significant=True,
        slow=False,
        one_by_one=True,
        first=plan.repeats * int(shifts.times[0]),
        last=plan.repeats * int(shifts.times[-1]),
        size_px=float(np.sqrt(np.mean(np.sum((pixels.gradient @ shifts.shift_px) ** 2, axis=1)))),
        shift=disturbance(apart),
        alternatives=(),
        unseen=spread,
    )


def _shares(fringe: Fringe, plan: SequencePlan, times: Ints) -> Floats:
    """Return the share (N,) of the shift of each frame in the coordinate from a fringe, averaged over its phases."""
    shares = np.zeros(len(times))
    of_frame = np.sum(fringe.weights[1:] * fringe.design[:, 1:].T, axis=0) / 2
    for k, number in enumerate(fringe.frames):
        shares[times == plan.shown.index(number)] = of_frame[k]
    return shares


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
