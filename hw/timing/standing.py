"""Whether a picture stands: two frames of a stream that follow each other show it, all of it, and nothing else."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from hw.timing.complementary_sums import ComplementarySums
from hw.timing.resting import RestingLight

_BANDS = 8  # of rows: a rolling shutter mixes two pictures in some of them
_PARTS = 8  # of each band, side by side: how much they differ tells what is chance, in blocks of JPEG as well
_MOST_SHARE = 0.01  # of the picture before; with a fringe of 16 px in 4 steps a fortieth of a projector pixel
_MOST_CHANGE = 0.01  # of brightness, from frame to frame
_SIGMAS = 4.0
_LEAST_CHANGE = 0.02  # rms, relative to black and white: below it two pictures look alike


@dataclass(frozen=True)
class Standing:
    """Compares frames at the pixels of `sums`, brightness (N,) each; `order` (B, P, n) are those of each part of each
    band of rows.
    """

    sums: ComplementarySums
    order: np.ndarray
    most_change: float

    def stands(self, before: Floats | None, last: Floats, now: Floats) -> bool:
        """Whether two frames are alike, with nothing in the `last` of the picture `before` that is gone `now`.

        Where `last` = (1 − s) now + s before, s is found in each band of rows by least squares, along what lies between
        `before` and the mean of both frames: their noise, whatever it is, is in the difference of the two and in that
        sum with opposite signs, and drops out. Parts of a band that disagree say how much is chance: noise of video is
        not independent from pixel to pixel (the variance of a ratio of sums of clusters; Cochran, Sampling Techniques).
        """
        step = now - last
        if abs(float(step.mean())) > self.most_change:
            return False
        if before is None:
            return True
        step, change = step[self.order], ((now + last) / 2 - before)[self.order]
        power = np.mean(change**2, axis=2)
        total = power.mean(axis=1)
        told = total > self._least_power
        if not told.any():
            return True
        along = np.mean(step * change, axis=2)[told]
        share = along.mean(axis=1) / total[told]
        variance = np.var(along - share[:, None] * power[told], axis=1, ddof=1).mean()
        by_chance = np.sqrt(variance / _PARTS) / total[told]
        return bool(np.all(np.abs(share) < _MOST_SHARE + _SIGMAS * by_chance))

    def differs(self, before: Floats, now: Floats) -> bool:
        """Whether a frame shows another picture than the one before."""
        return float(np.mean((now - before) ** 2)) > self._least_power

    @property
    def _least_power(self) -> float:
        """Of a difference that is more than noise."""
        return _LEAST_CHANGE**2 + 4 * self.sums.variance


def standing(rest: RestingLight) -> Standing:
    """For what black and white look like at rest."""
    rows, columns = rest.sums.pixels
    band = max(_PARTS, len(rows) // _BANDS // _PARTS * _PARTS)
    order = np.argsort(rows, kind="stable")[: len(rows) // band * band].reshape(-1, band)
    across = np.take_along_axis(order, np.argsort(columns[order], axis=1, kind="stable"), axis=1)
    return Standing(rest.sums, across.reshape(len(across), _PARTS, -1), max(_MOST_CHANGE, 2 * rest.tolerance))
