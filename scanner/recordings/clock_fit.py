"""Exposure, line time, tone curve, and start and slot length of each loop.

They are estimated by robust least squares from the shares of the frames around all changes, from the starts that
`clock_search` compares.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from calib.numerics import Floats
from scanner.recordings.clock_search import search_clocks
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples
from scanner.recordings.shares import ROBUST, loss, misfit, observe
from scanner.recordings.single_changes import with_scatter, with_shifts
from scanner.recordings.start_marks import Loop
from scanner.recordings.times_fit import fit_times
from scanner.recordings.tone_curve import ToneCurve

_MOST_ROUNDS, _SETTLED = 4, 0.1
# Prior of the tone curve: exponent and contrast with standard deviations.
_TONE_PRIOR = ((2.2, 0.4), (0.0, 0.25))
_TONE_BOUNDS = ((1.0, 4.0), (-0.9, 0.9))
_TONE_STEPS = (0.02, 0.02)
_INDEPENDENT = 300  # number of independent shares; those of neighbouring rows, and of curves of one kind, correlate


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
    return with_scatter(observe(samples, programme, clocks), clocks)


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
