"""Decides whether a picture is stable: two successive frames of a stream show it completely, and nothing else."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from hw.timing.complementary_sums import ComplementarySums
from hw.timing.resting import RestingLight

_BANDS = 8  # of rows: a rolling shutter mixes two pictures in some of them
_PARTS = 8  # of each band, side by side; their scatter measures noise, including that of JPEG blocks
_MOST_SHARE = 0.01  # of the previous picture; with a fringe of 16 px in 4 steps a fortieth of a projector pixel
_MOST_CHANGE = 0.01  # of brightness, from frame to frame
_SIGMAS = 4.0
_LEAST_CHANGE = 0.02  # rms, relative to white minus black: below it two pictures look alike


@dataclass(frozen=True)
class StabilityTest:
    """Compares frames by their brightness (N,) at the pixels of `sums`. `order` (B, P, n): indices of these pixels, by
    band of rows and part of the band.
    """

    sums: ComplementarySums
    order: np.ndarray
    most_change: float

    def is_stable(self, before: Floats | None, last: Floats, now: Floats) -> bool:
        """Whether the frames `last` and `now` are alike, without a share of the picture `before` in `last`.

        The share s in `last` = (1 − s) now + s before is found in each band of rows by least squares, regressing
        `now` − `last` on the mean of both minus `before`. Noise of the two frames is uncorrelated between their
        difference and their mean. The scatter between parts of a band gives the uncertainty, because noise of video is
        correlated between pixels (variance of a ratio of cluster sums; Cochran, Sampling Techniques).
        """
        step = now - last
        if abs(float(step.mean())) > self.most_change:
            return False
        if before is None:
            return True
        step, change = step[self.order], ((now + last) / 2 - before)[self.order]
        power = np.mean(change**2, axis=2)
        total = power.mean(axis=1)
        significant = total > self._least_power
        if not significant.any():
            return True
        along = np.mean(step * change, axis=2)[significant]
        share = along.mean(axis=1) / total[significant]
        variance = np.var(along - share[:, None] * power[significant], axis=1, ddof=1).mean()
        by_chance = np.sqrt(variance / _PARTS) / total[significant]
        return bool(np.all(np.abs(share) < _MOST_SHARE + _SIGMAS * by_chance))

    def differs(self, before: Floats, now: Floats) -> bool:
        """Whether two frames show different pictures."""
        return float(np.mean((now - before) ** 2)) > self._least_power

    @property
    def _least_power(self) -> float:
        """The smallest mean square of a difference that exceeds noise."""
        return _LEAST_CHANGE**2 + 4 * self.sums.variance


def stability_test(rest: RestingLight) -> StabilityTest:
    """Made from black and white at rest."""
    rows, columns = rest.sums.pixels
    band = max(_PARTS, len(rows) // _BANDS // _PARTS * _PARTS)
    order = np.argsort(rows, kind="stable")[: len(rows) // band * band].reshape(-1, band)
    across = np.take_along_axis(order, np.argsort(columns[order], axis=1, kind="stable"), axis=1)
    return StabilityTest(rest.sums, across.reshape(len(across), _PARTS, -1), max(_MOST_CHANGE, 2 * rest.tolerance))
