"""The time of a change in a series of pictures of one scene: between two of them, or during one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import MANY_PIXELS, Bools, Floats, Image, evenly_spread
from scanner.decoding.significance import FEWEST_PIXELS

# A picture with at least this share of the change, and of the rest, was taken during it. With less, a camera that
# turned before the finest bits would have turned by a part of it during them.
_PARTLY = 0.25


@dataclass(frozen=True)
class TimeOfChange:
    """The completed share `done` (K,) of a change in each of K pictures.

    `gained`: ratio of the explained difference to that of a change at the given place.
    """

    done: Floats
    gained: float

    @property
    def before(self) -> tuple[int, ...]:
        """Numbers of the pictures before the change."""
        return tuple(np.flatnonzero(self.done == 0).tolist())

    @property
    def after(self) -> tuple[int, ...]:
        """Numbers of the pictures after it."""
        return tuple(np.flatnonzero(self.done == 1).tolist())


def time_of_change(
    pictures: Sequence[Image], chosen: Bools, first: int, stripes: Sequence[float]
) -> TimeOfChange | None:
    """Locate a single change of pictures (H, W) at `chosen` pixels (H, W), compared with a change after the `first`
    few.

    `stripes`: stripe width of the pair that each picture is the sum of. None if there are too few pixels, or if sorting
    the pictures by stripe width separates them better than sorting by time: stripes that were sharpened or rescaled do
    not add up to even light. A change of overall brightness is ignored.
    """
    pixels = np.flatnonzero(chosen)
    if len(pixels) < FEWEST_PIXELS:
        return None
    pixels = evenly_spread(pixels, MANY_PIXELS)
    levels = np.stack([picture.reshape(-1)[pixels] for picture in pictures]).astype(np.float64)
    mean = levels.mean(axis=0)
    light = np.stack([np.ones_like(mean), mean])
    levels -= levels @ np.linalg.pinv(light) @ light  # the mean may be even itself
    count = len(levels)
    between = _between_groups(levels)
    if between.max() < _between_groups(levels[np.argsort(stripes, kind="stable")]).max():
        return None
    best = int(np.argmax(between)) + 1
    # Either picture next to the change may have been taken during it.
    before, after = (part.mean(axis=0) for part in (levels[: max(best - 1, 1)], levels[min(best + 1, count - 1) :]))
    done = (levels - before) @ (after - before) / max(float((after - before) @ (after - before)), 1e-12)
    shares = (np.arange(count) >= best).astype(np.float64)
    at_change = np.array([number for number in (best - 1, best) if 0 < number < count - 1], np.int64)
    partly = at_change[np.abs(done[at_change] - 0.5) < 0.5 - _PARTLY]
    shares[partly] = done[partly]
    return TimeOfChange(shares, float(between[best - 1] / max(between[first - 1], 1e-12)))


def _between_groups(levels: Floats) -> Floats:
    """Return the sum of squares between the groups, (K - 1,), for each split of a list (K, P) in two."""
    count = len(levels)
    splits = np.arange(1, count)
    sums = np.cumsum(levels, axis=0)[:-1]
    between: Floats = np.sum(sums**2, axis=1) * count / (splits * (count - splits))
    return between
