"""Exposure, line time, tone curve, and start and slot length of each loop.

They are estimated by robust least squares from the shares of the frames around all changes.
"""

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from calib.numerics import Floats
from scanner.recordings.clocks import Clocks
from scanner.recordings.programme import Programme
from scanner.recordings.samples import VideoSamples
from scanner.recordings.shares import ROBUST, Shares, loss, misfit, observe
from scanner.recordings.single_changes import with_scatter, with_shifts
from scanner.recordings.start_marks import Loop
from scanner.recordings.tone_curve import ToneCurve

_EXPOSURES_S = np.geomspace(1 / 1000, 1 / 24, 6)
_READOUTS_S = np.linspace(-0.03, 0.03, 7)
_SHIFTS = np.linspace(-0.5, 0.5, 5)  # of the loops, in frames
_STARTS = 3
_LONGEST_READOUT_S, _SHORTEST_EXPOSURE_S = 0.045, 1e-4
_MOST_ROUNDS, _SETTLED = 4, 0.1
# Prior of the tone curve: exponent and contrast with standard deviations.
_TONE_PRIOR = ((2.2, 0.4), (0.0, 0.25))
_TONE_BOUNDS = ((1.0, 4.0), (-0.9, 0.9))
_TONE_STEPS = (0.02, 0.02)
_INDEPENDENT = 300  # number of independent shares; those of neighbouring rows correlate


def fit_clocks(samples: VideoSamples, programme: Programme, loops: tuple[Loop, ...]) -> Clocks:
    """Fit the clocks to loops located by their start marks."""
    still = tuple(np.zeros(len(programme.loop) + 1) for _ in loops)
    exposure = min(samples.frame_interval_s / 2, programme.hold_s / 4)
    clocks = Clocks(exposure, 0.0, loops, still, ToneCurve(), 0.0)
    for _ in range(_MOST_ROUNDS):
        before = clocks.exposure_s
        shares = observe(samples, programme, clocks)
        starts = [clocks, *_starts(samples, shares, clocks)]
        clocks = min((_fit_times(samples, shares, start) for start in starts), key=lambda each: each[0])[1]
        clocks = with_shifts(samples, programme, _fit_tone(samples, programme, clocks))
        if abs(clocks.exposure_s / before - 1) < _SETTLED:
            break
    shares = observe(samples, programme, clocks)
    _, clocks = _fit_times(samples, shares, clocks)
    return with_scatter(samples, programme, clocks)


def _starts(samples: VideoSamples, shares: Shares, clocks: Clocks) -> list[Clocks]:
    """The likeliest few of a grid of exposures, readouts and times at which the loops begin."""
    height = samples.video.size.height
    tried = []
    exposures = [each for each in _EXPOSURES_S if each < 1.3 * samples.frame_interval_s]
    for exposure, readout, shift in product(exposures, _READOUTS_S, _SHIFTS * samples.frame_interval_s):
        loops = tuple(replace(loop, start_s=loop.start_s + float(shift)) for loop in clocks.loops)
        start = replace(clocks, exposure_s=float(exposure), line_s=float(readout / height), loops=loops)
        tried.append((float(loss(misfit(samples, shares, start)).sum()), start))
    return [start for _, start in sorted(tried, key=lambda each: each[0])[:_STARTS]]


def _fit_times(samples: VideoSamples, shares: Shares, start: Clocks) -> tuple[float, Clocks]:
    """(cost, clocks): exposure, line time, beginnings and slots under the shares of one tone curve."""
    height, slot = samples.video.size.height, start.loops[0].slot_s
    unit_s = 1e-3

    def misfit_of(values: Floats) -> Floats:
        return misfit(samples, shares, clocks_of(values))

    def clocks_of(values: Floats) -> Clocks:
        times = values[2:].reshape(-1, 2) * unit_s
        # The middle of a loop and its slot length hardly correlate.
        loops = tuple(
            Loop(loop.start_s + at - change / 2, loop.slot_s + change / len(start.shifts_s[0]))
            for loop, (at, change) in zip(start.loops, times, strict=True)
        )
        return replace(
            start, exposure_s=float(np.exp(values[0])), line_s=float(values[1] * unit_s / height), loops=loops
        )

    longest = 1.05 * samples.frame_interval_s
    first = np.zeros(2 + 2 * len(start.loops))
    first[:2] = np.log(min(start.exposure_s, 0.99 * longest)), start.line_s * height / unit_s
    lower, upper = np.full(len(first), -slot / 2 / unit_s), np.full(len(first), slot / 2 / unit_s)
    lower[:2] = np.log(_SHORTEST_EXPOSURE_S), -_LONGEST_READOUT_S / unit_s
    upper[:2] = np.log(longest), _LONGEST_READOUT_S / unit_s
    found = least_squares(
        misfit_of,
        first,
        bounds=(lower, upper),
        loss="soft_l1",
        f_scale=ROBUST,
        x_scale=np.concatenate([[0.3, 3.0], np.full(len(first) - 2, 1.0)]),
        diff_step=np.full(len(first), 1e-3),
        max_nfev=40,
    )
    return float(found.cost), clocks_of(found.x)


def _fit_tone(samples: VideoSamples, programme: Programme, clocks: Clocks) -> Clocks:
    """The curve for which brightening and darkening pixels give the same shares, by Gauss–Newton steps."""

    def residuals(values: Floats) -> Floats:
        tone = ToneCurve(*values)
        off = misfit(samples, observe(samples, programme, replace(clocks, tone=tone)), clocks)
        damped = np.sqrt(loss(off)) / ROBUST * np.sqrt(_INDEPENDENT / max(len(off), 1))
        prior = [(value - mean) / sigma for value, (mean, sigma) in zip(values, _TONE_PRIOR, strict=True)]
        return np.concatenate([damped, prior])

    lower, upper = zip(*_TONE_BOUNDS, strict=True)
    first = np.clip([clocks.tone.exponent, clocks.tone.contrast], np.add(lower, 0.05), np.subtract(upper, 0.05))
    found = least_squares(
        residuals, first, bounds=(lower, upper), diff_step=_TONE_STEPS, x_scale=(0.4, 0.25), max_nfev=8
    )
    return replace(clocks, tone=ToneCurve(*(float(value) for value in found.x)))
