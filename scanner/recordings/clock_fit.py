"""Exposure, line time, tone curve, and start and slot length of each loop.

They are estimated by robust least squares from the shares of the frames around all changes, from starts all over what
cameras and players do.

Around the changes, frames show the same shares if exposure, readout, and the drift of the changes against the frames
are all scaled alike: the interval of the frames alone tells the scale, where a change wraps from one frame to the next.
Fits of a wrong scale have these changes come off their time. So fits are compared after single changes, of frames that
a player or a camera dropped or showed twice, were allowed to come off their time, by the Bayesian information criterion
(Schwarz 1978, Annals of Statistics 6, 461) with each such change as a parameter, under the noise that they leave.
"""

import math
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from calib.numerics import Floats
from scanner.recordings.clocks import Clocks, Loop
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples
from scanner.recordings.shares import (
    ROBUST,
    Shares,
    after_changes,
    frames_come_unevenly,
    independent_shares,
    loss,
    mean_loss,
    misfit,
    observe,
    predicted,
)
from scanner.recordings.video_file import ToneCurve

_MOST_ROUNDS, _SETTLED = 4, 0.1
# Prior of the tone curve: exponent and contrast with standard deviations.
_TONE_PRIOR = ((2.2, 0.4), (0.0, 0.25))
_TONE_BOUNDS = ((1.0, 4.0), (-0.9, 0.9))
_TONE_STEPS = (0.02, 0.02)
# Twice the scatter of changes around their times, in exposures: more leaves the exposure open.
_SCATTERS, _MOST_SCATTER = 2.0, 0.1
_SHORT_S = 0.001
_INDEPENDENT = 300  # number of independent shares; those of neighbouring rows, and of curves of one kind, correlate
_EXPOSURES_S = np.geomspace(1 / 1000, 1 / 24, 6)
_LONGEST_EXPOSURE = 1.3  # frame intervals
_READOUTS_S = np.linspace(-0.03, 0.03, 7)
# In frame intervals: marks tell start and end of a loop to half of one each.
_MIDDLES, _LENGTHS = np.linspace(-0.5, 0.5, 5), np.linspace(-1, 1, 9)
_EVERY = 4  # rows of the samples are enough to compare
_AS_LIKELY = 10.0  # of the criterion: odds of 150 to 1
_LONGEST_READOUT_S, _SHORTEST_EXPOSURE_S = 0.045, 1e-4
_UNIT_S = 1e-3
_MOST_STEPS = 40
_CANDIDATES = np.linspace(-0.45, 0.45, 91)  # shifts of a change, in slots
_LEAST_SHIFT_S = 0.008  # half a refresh period of a projector
_AS_GOOD = 0.1  # share of the loss of a robust deviation, per row
_GAIN_OF_SHIFT = 0.5  # a shift is accepted if it leaves less than this share of the cost


def fit_times_and_clocks(
    samples: VideoSamples, programme: Programme, loops: tuple[Loop, ...]
) -> tuple[VideoSamples, Clocks]:
    """The samples with the times of their frames that explain them better, as stamped or evenly, and the clocks.

    Stamps may tell when a frame was handled, not when it was exposed.
    """
    fits = [(times, fit_clocks(times, programme, loops)) for times in (samples, samples.with_even_times()) if times]
    if len(fits) == 1:
        return fits[0]
    shares = [observe(times, programme, clocks) for times, clocks in fits]
    costs = [mean_loss(share, clocks) for share, (_, clocks) in zip(shares, fits, strict=True)]
    best = costs.index(min(costs))
    count = independent_shares(shares[best], fits[best][1])
    criteria = [
        criterion(cost, count, share, clocks) for cost, share, (_, clocks) in zip(costs, shares, fits, strict=True)
    ]
    return fits[criteria.index(min(criteria))]


def fit_clocks(samples: VideoSamples, programme: Programme, loops: tuple[Loop, ...]) -> Clocks:
    """Fit the clocks to loops located by their start marks."""
    still = tuple(np.zeros(len(programme.loop) + 1) for _ in loops)
    exposure = min(samples.frame_interval_s / 2, programme.hold_s / 4)
    clocks = Clocks(exposure, 0.0, loops, still, ToneCurve(), 0.0, (exposure, exposure))
    for _ in range(_MOST_ROUNDS):
        before = clocks.exposure_s
        clocks = search_clocks(samples, observe(samples, programme, clocks), clocks)
        clocks = with_shifts(observe(samples, programme, clocks), _fit_tone(samples, programme, clocks))
        if abs(clocks.exposure_s / before - 1) < _SETTLED:
            break
    clocks = fit_times(samples, observe(samples, programme, clocks), clocks)
    shares = observe(samples, programme, clocks)
    clocks = with_scatter(shares, clocks)
    if _SCATTERS * clocks.scatter_s < _MOST_SCATTER * clocks.exposure_s or not frames_come_unevenly(shares, clocks):
        return clocks
    # Changes that come off their time blur the shares as a longer exposure does, or are taken for late pictures.
    least, greatest = clocks.exposures_s
    return replace(clocks, exposures_s=(min(least, _SHORT_S), max(greatest, samples.frame_interval_s)))


def _fit_tone(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Clocks:
    """The curve for which brightening and darkening pixels give the same shares, by Gauss–Newton steps."""

    def residuals(values: Floats) -> Floats:
        tone = ToneCurve(*values)
        shares = observe(samples, programme, replace(clocks, tone=tone))
        off = misfit(shares, clocks).ravel()
        damped = np.sqrt(loss(off)) / ROBUST * np.sqrt(_INDEPENDENT / max(len(off), 1))
        prior = [(value - mean) / sigma for value, (mean, sigma) in zip(values, _TONE_PRIOR, strict=True)]
        return np.concatenate([damped, prior])

    lower, upper = zip(*_TONE_BOUNDS, strict=True)
    first = np.clip([clocks.tone.exponent, clocks.tone.contrast], np.add(lower, 0.05), np.subtract(upper, 0.05))
    fit = least_squares(residuals, first, bounds=(lower, upper), diff_step=_TONE_STEPS, x_scale=(0.4, 0.25), max_nfev=8)
    return replace(clocks, tone=ToneCurve(*(float(value) for value in fit.x)))


def search_clocks(samples: VideoSamples, shares: Shares, clocks: Clocks) -> Clocks:
    """The likeliest fit to the shares, under the clocks' tone curve; `exposures_s` is the range over fits that are as
    likely.
    """
    thin = shares.every(_EVERY)
    fits = []
    for start in (clocks, *_starts(samples, thin, clocks)):
        shifted = with_shifts(thin, fit_times(samples, thin, start))
        fits.append(fit_times(samples, shares, shifted))
    costs = [mean_loss(shares, fit) for fit in fits]
    independent = independent_shares(shares, fits[int(np.argmin(costs))])
    criteria = [criterion(cost, independent, shares, fit) for cost, fit in zip(costs, fits, strict=True)]
    least = min(criteria)
    exposures_s = [fit.exposure_s for value, fit in zip(criteria, fits, strict=True) if value < least + _AS_LIKELY]
    return replace(fits[criteria.index(least)], exposures_s=(min(exposures_s), max(exposures_s)))


def criterion(cost: float, independent: float, shares: Shares, clocks: Clocks) -> float:
    """Of clocks that leave a mean `cost` of so many `independent` shares; each shifted change is a parameter."""
    shifts = np.count_nonzero(np.concatenate(clocks.shifts_s)[shares.weight_of_changes > 0])
    return independent * math.log(max(cost, 1e-15)) + shifts * math.log(independent)


def _starts(samples: VideoSamples, shares: Shares, clocks: Clocks) -> list[Clocks]:
    """For each exposure the likeliest of a grid of readouts, and of times of each loop's middle and its length."""
    height, slots = samples.video.size.height, len(clocks.shifts_s[0]) - 1
    even = tuple(np.zeros_like(shifts) for shifts in clocks.shifts_s)
    moves = [
        tuple(Loop(loop.start_s + middle - longer / 2, loop.slot_s + longer / slots) for loop in clocks.loops)
        for middle, longer in product(_MIDDLES * samples.frame_interval_s, _LENGTHS * samples.frame_interval_s)
    ]
    starts = []
    longest_s = _LONGEST_EXPOSURE * samples.frame_interval_s
    for exposure in _EXPOSURES_S[: np.searchsorted(_EXPOSURES_S, longest_s)]:
        tried = []
        for readout in _READOUTS_S:
            start = replace(clocks, exposure_s=float(exposure), line_s=float(readout / height), shifts_s=even)
            costs = np.array([_cost_of_loops(shares, replace(start, loops=loops)) for loops in moves])
            best = costs.argmin(axis=0)
            loops = tuple(moves[number][loop] for loop, number in enumerate(best.tolist()))
            tried.append((float(costs.min(axis=0).sum()), replace(start, loops=loops)))
        starts.append(min(tried, key=lambda start: start[0])[1])
    return starts


def _cost_of_loops(shares: Shares, clocks: Clocks) -> Floats:
    """Cost of the changes of each loop, (loops,)."""
    costs: Floats = shares.summed(loss(misfit(shares, clocks))).reshape(len(clocks.loops), -1).sum(axis=1)
    return costs


def fit_times(samples: VideoSamples, shares: Shares, start: Clocks) -> Clocks:
    """The nearest minimum by robust least squares; the changes keep their shifts.

    Parameters: logarithm of the exposure, readout of all rows, and of each loop the time of its middle and its length,
    which hardly correlate.
    """
    height, slots = samples.video.size.height, len(start.shifts_s[0]) - 1

    def clocks_of(values: Floats) -> Clocks:
        times = values[2:].reshape(-1, 2) * _UNIT_S
        loops = tuple(
            Loop(loop.start_s + middle - longer / 2, loop.slot_s + longer / slots)
            for loop, (middle, longer) in zip(start.loops, times, strict=True)
        )
        exposure_s, line_s = float(np.exp(values[0])), float(values[1] * _UNIT_S / height)
        return replace(start, exposure_s=exposure_s, line_s=line_s, loops=loops)

    def misfit_of(values: Floats) -> Floats:
        return misfit(shares, clocks_of(values)).ravel()

    loop, slot = np.divmod(shares.change, slots + 1)

    def slopes_of(values: Floats) -> Floats:
        """Derivatives of the misfit, (M · R · 2, parameters)."""
        clocks = clocks_of(values)
        after = after_changes(shares, clocks)
        share = predicted(after, clocks.exposure_s)
        between = ((share > 0) & (share < 1)) / clocks.exposure_s
        later = np.zeros((*share.shape, len(values)))
        later[..., 0] = -after * between
        later[..., 1] = shares.row * (_UNIT_S / height) * between
        for number in range(len(start.loops)):
            own = -_UNIT_S * between * (loop == number)[:, None]
            later[..., 2 + 2 * number] = own
            later[..., 3 + 2 * number] = own * (slot / slots - 0.5)[:, None]
        slopes = -shares.weight[..., None] * later[:, :, None]
        return slopes.reshape(-1, len(values))

    longest = 1.05 * samples.frame_interval_s
    reach = start.loops[0].slot_s / 2 / _UNIT_S
    first = np.zeros(2 + 2 * len(start.loops))
    first[:2] = np.log(min(start.exposure_s, 0.99 * longest)), start.line_s * height / _UNIT_S
    lower, upper = np.full(len(first), -reach), np.full(len(first), reach)
    lower[:2] = np.log(_SHORTEST_EXPOSURE_S), -_LONGEST_READOUT_S / _UNIT_S
    upper[:2] = np.log(longest), _LONGEST_READOUT_S / _UNIT_S
    fit = least_squares(
        misfit_of,
        first,
        slopes_of,
        bounds=(lower, upper),
        loss="soft_l1",
        f_scale=ROBUST,
        x_scale=np.concatenate([[0.3, 3.0], np.full(len(first) - 2, 1.0)]),
        max_nfev=_MOST_STEPS,
    )
    return clocks_of(fit.x)


def with_shifts(shares: Shares, clocks: Clocks) -> Clocks:
    """Changes that come late or early for good: frames that a player or a camera dropped or showed twice."""
    measured = _measured_shifts(shares, clocks)
    shifts = []
    for loop, (times, before, after) in zip(clocks.loops, measured, strict=True):
        # A change without information takes the shift of the one before.
        kept, current = np.zeros(len(times)), 0.0
        for number in range(len(times)):
            if np.isfinite(times[number]):
                believed = after[number] < _GAIN_OF_SHIFT * before[number] and abs(times[number]) > _LEAST_SHIFT_S
                current = times[number] if believed else 0.0
            kept[number] = current
        shifts.append(np.clip(kept, -0.45 * loop.slot_s, 0.45 * loop.slot_s))
    return replace(clocks, shifts_s=tuple(shifts))


def with_scatter(shares: Shares, clocks: Clocks) -> Clocks:
    """Return the clocks with the remaining scatter of the changes around their predicted times."""
    measured = _measured_shifts(shares, clocks)
    off = np.concatenate([times - kept for (times, _, _), kept in zip(measured, clocks.shifts_s, strict=True)])
    off = off[np.isfinite(off)]
    return replace(clocks, scatter_s=float(np.sqrt(np.mean(off**2))) if off.size else 0.0)


def _measured_shifts(shares: Shares, clocks: Clocks) -> list[tuple[Floats, Floats, Floats]]:
    """For each loop and change: the shift from evenness that fits best, NaN where nothing changed; costs without and
    with it.
    """
    even = replace(clocks, shifts_s=tuple(np.zeros_like(shifts) for shifts in clocks.shifts_s))
    costs = np.stack([_cost_of_changes(shares, even, by_slots) for by_slots in _CANDIDATES.tolist()])
    best = costs.min(axis=0)
    # Of all shifts that fit equally well, as for a change between two exposures, take the one closest to zero.
    fits = costs <= best + _AS_GOOD * ROBUST**2 * np.maximum(shares.weight_of_changes, 1)
    nearest = np.where(fits, np.abs(_CANDIDATES)[:, None], np.inf).argmin(axis=0)
    by_slots = np.where(shares.weight_of_changes > 0, _CANDIDATES[nearest], np.nan)
    loops = len(clocks.loops)
    parts = (np.split(values, loops) for values in (by_slots, costs[len(_CANDIDATES) // 2], best))
    return [
        (loop.slot_s * of_loop, before, after)
        for loop, of_loop, before, after in zip(clocks.loops, *parts, strict=True)
    ]


def _cost_of_changes(shares: Shares, clocks: Clocks, by_slots: float) -> Floats:
    """Cost of each change if it came later by this many slots, (changes,)."""
    moved = tuple(shifts + by_slots * loop.slot_s for shifts, loop in zip(clocks.shifts_s, clocks.loops, strict=True))
    return shares.summed(loss(misfit(shares, replace(clocks, shifts_s=moved))))
