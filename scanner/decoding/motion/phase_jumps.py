"""Motion by whole parts of a period: of fringes against their code, and among the frames of a fringe.

A motion between the codes of an axis and its fringes offsets the fringes from the cells of the code.

After a bump by about a whole period, the fringes agree with their code again, but not everywhere, since a turn moves
the middle of the picture less than its sides. A pinhole of focal length f that pans by u px moves the place X by u (1 +
X² / f²), and the place (X, Y) of the other axis by u X Y / f². This curvature reveals the turn itself, whatever whole
periods are subtracted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np

from calib.numerics import ENOUGH_PIXELS, Bools, Floats, Floats32, HuberFit, Ints, evenly_spread, fit_huber
from scanner.decoding.codes import interval_of
from scanner.decoding.coordinates import Signals
from scanner.decoding.light import MOST_ALONG, TILE_PX, NoiseModel, TileSample
from scanner.decoding.motion.fringe_pixels import ObservedFringes
from scanner.decoding.motion.motion_estimate import CodeShift, DetectedMotion
from scanner.decoding.sequence_plan import COSINE_PARAMETERS, AxisPlan, Fringe, SequencePlan
from scanner.decoding.significance import (
    AS_GOOD,
    ENDS,
    FEW,
    FEWEST_PIXELS,
    HUBER_ROUNDS,
    HUBER_SIGMAS,
    NEARLY_ALL,
    REJECTED,
    SIGNIFICANT_SIGMAS,
)

_BLOCKS = (8, 6)  # of the projector's picture along x and y
# Offsets fill a cell evenly, so that the middle of these quantiles is accurate to a hundredth of it. Blocks of partial
# cells are rejected, whose width differs by more than this share.
_QUANTILE = 0.04
_WIDTH_OFF = 0.25
_FEWEST_BLOCKS = 12  # for eight parameters
# Offset, slopes along x and y, of either axis; then the curvatures of a pan and of a tilt.
_SLOPES, _COLUMNS = 3, 8
# Least and largest focal length of projectors, in widths of the picture.
_LEAST_FOCAL, _MOST_FOCAL = 0.8, 2.7
_LEAST_PX = 0.5


@dataclass(frozen=True)
class Offsets:
    """Offsets of the longest fringe of an axis from the middle of the code's cell, in projector pixels, at P pixels."""

    axis: AxisPlan
    """Which."""
    centre: Floats32
    """(P,): middles of the cells."""
    px: Floats32
    """(P,): relative to the mean, within half a period."""
    mean_px: float
    """Common to all pixels."""
    known: Bools
    """(P,): whether code and fringe are known."""

    @property
    def period(self) -> float:
        """Period of the fringe in projector pixels."""
        return self.axis.fringes[0].period


def shifts_of_codes(fringes: ObservedFringes) -> tuple[CodeShift, ...]:
    """Return the significant shifts, from the pixels where nothing moved."""
    offsets = (_offsets(axis, of_axis, fringes.noise, fringes.tiles.static) for axis, of_axis in fringes.axes)
    known = [offset for offset in offsets if offset is not None]
    by_periods = [*moved_by_periods(fringes.plan, *known)] if len(known) == len(fringes.plan.axes) else []
    remaining = [offset for offset in known if offset.axis not in [shift.axis for shift in by_periods]]
    # A finest bit that was exchanged with its inverse also shifts by half a period.
    shifted = [offset for offset in remaining if _LEAST_PX <= abs(offset.mean_px) <= AS_GOOD * offset.period / 2]
    return (*by_periods, *(_code_shift(fringes.plan, offset.axis, offset.mean_px) for offset in shifted))


def _code_shift(
    plan: SequencePlan, axis: AxisPlan, px: float, *, by_periods: bool = False, is_sure: bool = True
) -> CodeShift:
    axes = (axis,) if is_sure else plan.axes
    first = min(frame for axis in axes for code in axis.codes for frame in code.frames)
    last = max(frame for axis in axes for fringe in axis.fringes for frame in fringe.frames)
    between = f"between {plan.name(first)} and {plan.name(last)}"
    return CodeShift(first, last, px, axis, between, by_periods=by_periods, is_sure=is_sure)


def _offsets(axis: AxisPlan, signals: Signals, noise: NoiseModel, static: Bools) -> Offsets | None:
    """Return the offsets of the longest fringe from its code; None if there is no such pair, or the fringe follows no
    code.
    """
    if not axis.codes or not axis.fringes or axis.cell >= axis.fringes[0].period:
        return None
    longest = axis.fringes[0]
    if len(longest.frames) <= COSINE_PARAMETERS:
        return None
    interval = interval_of(axis, signals.words, len(signals.threshold))
    cosine, sine = signals.fringe(0)
    amplitude2 = cosine**2 + sine**2
    usable = (
        static
        & interval.possible
        & (amplitude2 > (SIGNIFICANT_SIGMAS * longest.noise_gain) ** 2 * noise.variance(signals.threshold))
    )
    if np.count_nonzero(usable) < FEWEST_PIXELS:
        return None
    px_per_radian = np.float32(longest.period / (2 * np.pi))
    beyond = np.arctan2(sine, cosine) - interval.centre / px_per_radian
    # Exchanged frames leave fringes that follow the code nowhere, or only in places.
    if abs(np.mean(np.exp(np.complex64(1j) * beyond[usable]))) < NEARLY_ALL * np.sinc(axis.cell / longest.period):
        return None
    about = middle_of(beyond[usable], axis.cell / longest.period)
    return Offsets(
        axis,
        interval.centre,
        px_per_radian * _wrapped(beyond - np.float32(about)),
        float(px_per_radian * about),
        usable,
    )


def middle_of(angles: Floats32, width: float) -> float:
    """Return the middle of the arc, `width` turns wide, that holds most of the angles (P,).

    The mean angle is unreliable where a cell is nearly as long as the period: a few angles more or less turn it.
    """
    some = np.sort(_wrapped(evenly_spread(angles)))
    turned = np.concatenate([some, some + 2 * np.pi])
    held = np.searchsorted(turned, some + 2 * np.pi * width, side="right") - np.arange(len(some))
    first = int(np.argmax(held))
    about = float(_wrapped((turned[[first]] + turned[first + held[first] - 1]) / 2)[0])
    return about + float(np.quantile(_wrapped(angles - np.float32(about)), ENDS).mean())


def _wrapped(angles: Floats32) -> Floats32:
    """Wrap angles to ±π."""
    wrapped: Floats32 = angles - 2 * np.pi * np.rint(angles / (2 * np.pi))
    return wrapped


def moved_by_periods(plan: SequencePlan, x: Offsets, y: Offsets) -> Iterator[CodeShift]:
    """Yield the motions along x and y that include whole periods."""
    axes, width = (x, y), x.axis.length
    chosen = evenly_spread(np.flatnonzero(x.known & y.known), 4 * ENOUGH_PIXELS)  # some hundreds for each block
    place = np.stack(
        [(offset.centre[chosen].astype(np.float64) - (offset.axis.length - 1) / 2) / width for offset in axes], axis=1
    )
    block = _block(place, y.axis.length / width)
    of_axes = [_of_blocks(number, offset, offset.px[chosen], place, block) for number, offset in enumerate(axes)]
    rows, offsets = (np.concatenate(parts) for parts in zip(*of_axes, strict=True))
    if len(rows) < _FEWEST_BLOCKS:
        return
    alone = _may_move_alone(x.axis, y.axis), _may_move_alone(y.axis, x.axis)
    fit, moved, sure = _likeliest(rows, offsets, alone)
    sigma = fit.scale * np.sqrt(np.diag(fit.inverse))
    for number, offset in enumerate(axes):
        px = _by_periods(offset.period, fit.parameters[_SLOPES * number], fit.parameters[number - 2], sigma[number - 2])
        if moved[number] and px:
            yield _code_shift(plan, offset.axis, px, by_periods=True, is_sure=sure[number])


def _block(place: Floats, height: float) -> Ints:
    """Return the block (P,) of places (P, 2) relative to the middle of the picture, in its widths."""
    relative = place / (1, height) + 0.5
    column, row = np.clip(relative * _BLOCKS, 0, np.array(_BLOCKS) - 1).astype(np.int64).T
    block: Ints = row * _BLOCKS[0] + column
    return block


def _of_blocks(number: int, axis: Offsets, px: Floats32, place: Floats, block: Ints) -> tuple[Floats, Floats]:
    """Return the offsets (B,) of the fringe from the cells in blocks that these fill evenly, and their derivatives
    (B, 8) by each parameter; from pixels with offsets `px` (P,) at places (P, 2) in blocks (P,).
    """
    order = np.lexsort((px, block))
    first = np.flatnonzero(np.diff(block[order], prepend=-1))
    count = np.diff(first, append=len(order))
    low, high = (px[order[first + np.rint(q * (count - 1)).astype(np.int64)]] for q in (_QUANTILE, 1 - _QUANTILE))
    filled = (high - low) / ((1 - 2 * _QUANTILE) * axis.axis.cell)
    even = (count >= FEWEST_PIXELS) & (np.abs(filled - 1) < _WIDTH_OFF)
    terms = np.concatenate([place, place * place[:, [number]]], axis=1)[order]
    x_and_y, bends = np.split(np.add.reduceat(terms, first) / count[:, None], 2, axis=1)
    rows = np.zeros((len(first), _COLUMNS))
    rows[:, _SLOPES * number] = 1
    rows[:, _SLOPES * number + 1 : _SLOPES * (number + 1)] = x_and_y
    rows[:, -2:] = bends
    return rows[even], axis.mean_px + (low + high)[even] / 2


def _may_move_alone(axis: AxisPlan, second: AxisPlan) -> bool:
    """Return whether a bump may be among the frames of an axis, but not among those of the other one."""
    (first, last), (of_other, to_other) = (
        (min(frames), max(frames))
        for frames in (
            [*plan.fringes[0].frames, *(frame for code in plan.codes for frame in code.frames)]
            for plan in (axis, second)
        )
    )
    return first < of_other or last > to_other


def _likeliest(rows: Floats, offsets: Floats, alone: tuple[bool, bool]) -> tuple[HuberFit, list[bool], list[bool]]:
    """Return the best fit to blocks (M, 8) and (M,), which axes moved, and which of these moved for certain.

    It is certain if the alternative is impossible, or far less likely. `alone`: whether x or y may have moved alone.
    """
    both, of_y = fit_huber(rows.T, offsets, HUBER_SIGMAS, HUBER_ROUNDS), rows[:, _SLOPES] != 0
    static = []
    for blocks in (~of_y, of_y):
        bent = rows.copy()
        bent[blocks, -2:] = 0.0
        static.append(fit_huber(bent.T, offsets, HUBER_SIGMAS, HUBER_ROUNDS))
    worse = [
        fit.cost(both.scale) - both.cost(both.scale) if possible else inf
        for fit, possible in zip(static, reversed(alone), strict=True)
    ]
    likelier = int(worse[1] < worse[0])
    if worse[likelier] > -REJECTED:
        return both, [True, True], [by > REJECTED for by in worse]
    return static[likelier], [axis != likelier for axis in (0, 1)], [by > REJECTED for by in worse]


def _by_periods(period: float, offset_px: float, curvature: float, sigma: float) -> float:
    """Return the offset in the middle of the picture plus one whole period, or 0 if the curvature, in px per width²,
    needs none.
    """
    least, most = sorted((0.0, offset_px / _LEAST_FOCAL**2))
    beyond = curvature - min(max(curvature, least), most)
    if abs(beyond) < max(SIGNIFICANT_SIGMAS * sigma, period / _MOST_FOCAL**2):
        return 0.0
    return float(offset_px + np.sign(beyond) * period)


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


def find_phase_jump(fringes: ObservedFringes) -> DetectedMotion | None:
    """Return the bump between two frames that explains fringes which fit no cosine otherwise, or None."""
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
    return DetectedMotion(first, second, None)


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
