"""Whether a picture stands: two frames of a stream that follow each other show it, all of it, and nothing else."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats
from hw.timing.complementary_sums import ComplementarySums
from hw.timing.resting import RestingLight

_BANDS = 8  # of rows: a rolling shutter mixes two pictures in some of them
_MOST_SHARE = 0.01  # of the picture before; with a fringe of 16 px in 4 steps a fortieth of a projector pixel
_MOST_CHANGE = 0.01  # of brightness, from frame to frame
_SIGMAS = 4.0
_LEAST_CHANGE = 0.02  # rms, relative to black and white: below it two pictures look alike


@dataclass(frozen=True)
class Standing:
    """Compares frames at the pixels of `sums`, brightness (N,) each; `order` (B, n) are those of each band of rows."""

    sums: ComplementarySums
    order: np.ndarray
    most_change: float

    def stands(self, before: Floats | None, last: Floats, now: Floats) -> bool:
        """Whether two frames are alike, with nothing in the `last` of the picture `before` that is gone `now`.

        Where `last` = (1 − s) now + s before, s is found in each band of rows by least squares; noise of `now` is in
        both differences alike, and is taken off.
        """
        step = now - last
        if abs(float(step.mean())) > self.most_change:
            return False
        if before is None:
            return True
        step, change = step[self.order], (now - before)[self.order]
        power = np.mean(change**2, axis=1)
        told = power > _LEAST_CHANGE**2 + 4 * self.sums.variance
        if not told.any():
            return True
        share = (np.mean(step * change, axis=1) - self.sums.variance)[told] / power[told]
        by_chance = np.sqrt(np.mean(step**2, axis=1)[told] / power[told] / self.order.shape[1])
        return bool(np.all(np.abs(share) < _MOST_SHARE + _SIGMAS * by_chance))

    def differs(self, before: Floats, now: Floats) -> bool:
        """Whether a frame shows another picture than the one before."""
        return float(np.mean((now - before) ** 2)) > _LEAST_CHANGE**2 + 4 * self.sums.variance


def standing(rest: RestingLight) -> Standing:
    """For what black and white look like at rest."""
    rows = rest.sums.pixels[0]
    count = max(1, len(rows) // _BANDS)
    order = np.argsort(rows, kind="stable")[: count * (len(rows) // count)].reshape(-1, count)
    return Standing(rest.sums, order, max(_MOST_CHANGE, 2 * rest.tolerance))
