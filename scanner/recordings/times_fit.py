"""Exposure, line time, starts and slot lengths of the loops under the shares of one tone curve, near a start."""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from calib.numerics import Floats
from scanner.recordings.clocks import Clocks
from scanner.recordings.samples import VideoSamples
from scanner.recordings.shares import ROBUST, Shares, after_changes, misfit, predicted
from scanner.recordings.start_marks import Loop

_LONGEST_READOUT_S, _SHORTEST_EXPOSURE_S = 0.045, 1e-4
_UNIT_S = 1e-3
_MOST_STEPS = 40


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
