"""When it was that pictures of the same scene changed: between which two of them, or within one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.numerics import Bools, Floats, Image

# Some of the pixels tell it.
_MOST_PIXELS = 60_000
_FEWEST_PIXELS = 1_000
# A picture that has this share of the change is of before and after.
_PARTLY = 0.25


@dataclass(frozen=True)
class Moment:
    """Of K pictures, the share (K,) of a change that each has, `done`; `gained`: how many times as much of what they
    differ by it explains as a change between two given ones.
    """

    done: Floats
    gained: float

    @property
    def before(self) -> tuple[int, ...]:
        """Those that are as before."""
        return tuple(np.flatnonzero(self.done == 0).tolist())

    @property
    def after(self) -> tuple[int, ...]:
        """Those that are as after."""
        return tuple(np.flatnonzero(self.done == 1).tolist())


def moment_of(pictures: Sequence[Image], chosen: Bools, first: int, stripes: Sequence[float]) -> Moment | None:
    """When pictures (H, W) changed once, by `chosen` pixels (H, W), beside a change after the `first` few.

    `stripes`: how wide those are that each picture is the sum of. None where too few pixels tell, or where the pictures
    of narrow stripes differ from all others by more than the later ones from the earlier ones: stripes that were
    sharpened, or scaled to other pixels, do not add up to even light. What is brighter all over is no change.
    """
    pixels = np.flatnonzero(chosen)
    if len(pixels) < _FEWEST_PIXELS:
        return None
    pixels = pixels[:: -(-len(pixels) // _MOST_PIXELS)]
    levels = np.stack([picture.reshape(-1)[pixels] for picture in pictures]).astype(np.float64)
    mean = levels.mean(axis=0)
    light = np.stack([np.ones_like(mean), mean])
    levels -= levels @ np.linalg.pinv(light) @ light  # the mean may be even itself
    count = len(levels)
    between = _between_groups(levels)
    if between.max() < _between_groups(levels[np.argsort(stripes, kind="stable")]).max():
        return None
    best = int(np.argmax(between)) + 1
    # Either of those at the change may be of both sides of it.
    before, after = (part.mean(axis=0) for part in (levels[: max(best - 1, 1)], levels[min(best + 1, count - 1) :]))
    done = (levels - before) @ (after - before) / max(float((after - before) @ (after - before)), 1e-12)
    shares = (np.arange(count) >= best).astype(np.float64)
    at_change = np.array([number for number in (best - 1, best) if 0 < number < count - 1], np.int64)
    partly = at_change[np.abs(done[at_change] - 0.5) < 0.5 - _PARTLY]
    shares[partly] = done[partly]
    return Moment(shares, float(between[best - 1] / max(between[first - 1], 1e-12)))


def _between_groups(levels: Floats) -> Floats:
    """Of each split of a list (K, P) in two, the sum of squares between the groups, (K - 1,)."""
    count = len(levels)
    splits = np.arange(1, count)
    sums = np.cumsum(levels, axis=0)[:-1]
    between: Floats = np.sum(sums**2, axis=1) * count / (splits * (count - splits))
    return between
