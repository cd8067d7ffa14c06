"""Exposure, line time, tone curve, and start and slot length of each loop.

They are estimated by robust least squares from the shares of the frames around all changes, from the starts that
`clock_search` compares.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from calib.numerics import Floats
from scanner.recordings.clock_search import criterion, search_clocks
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples
from scanner.recordings.shares import ROBUST, frames_come_unevenly, independent_shares, loss, mean_loss, misfit, observe
from scanner.recordings.single_changes import with_scatter, with_shifts
from scanner.recordings.start_marks import Loop
from scanner.recordings.times_fit import fit_times
from scanner.recordings.tone_curve import ToneCurve

_MOST_ROUNDS, _SETTLED = 4, 0.1
# Prior of the tone curve: exponent and contrast with standard deviations.
_TONE_PRIOR = ((2.2, 0.4), (0.0, 0.25))
_TONE_BOUNDS = ((1.0, 4.0), (-0.9, 0.9))
_TONE_STEPS = (0.02, 0.02)
# Twice the scatter of changes around their times, in exposures: more leaves the exposure open.
_SCATTERS, _MOST_SCATTER = 2.0, 0.1
_SHORT_S = 0.001
_INDEPENDENT = 300  # number of independent shares; those of neighbouring rows, and of curves of one kind, correlate


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
