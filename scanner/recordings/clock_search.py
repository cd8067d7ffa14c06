"""The likeliest of several fits of the clocks, from starts all over what cameras and players do.

Around the changes, frames show the same shares if exposure, readout, and the drift of the changes against the frames
are all scaled alike: the interval of the frames alone tells the scale, where a change wraps from one frame to the next.
Fits of a wrong scale have these changes come off their time. So fits are compared after single changes were allowed to
come off their time, by the Bayesian information criterion (Schwarz 1978, Annals of Statistics 6, 461) with each such
change as a parameter, under the noise that they leave.
"""

import math
from dataclasses import replace
from itertools import product

import numpy as np

from calib.numerics import Floats
from scanner.recordings.clocks import Clocks
from scanner.recordings.samples import VideoSamples
from scanner.recordings.shares import Shares, independent_shares, loss, mean_loss, misfit
from scanner.recordings.single_changes import with_shifts
from scanner.recordings.start_marks import Loop
from scanner.recordings.times_fit import fit_times

_EXPOSURES_S = np.geomspace(1 / 1000, 1 / 24, 6)
_LONGEST_EXPOSURE = 1.3  # frame intervals
_READOUTS_S = np.linspace(-0.03, 0.03, 7)
# In frame intervals: marks tell start and end of a loop to half of one each.
_MIDDLES, _LENGTHS = np.linspace(-0.5, 0.5, 5), np.linspace(-1, 1, 9)
_EVERY = 4  # rows of the samples are enough to compare
_AS_LIKELY = 10.0  # of the criterion: odds of 150 to 1


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
