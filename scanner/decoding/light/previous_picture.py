"""The share of the previous picture in all frames of a capture, or in some of them."""

from collections.abc import Callable, Collection, Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from calib.numerics import Floats32, medians
from scanner.decoding.sequence_plan import SequencePlan


def share_of_previous(
    plan: SequencePlan,
    levels: Floats32,
    off: Callable[[Floats32], float],
    most: float,
    frames: Collection[int] | None = None,
) -> tuple[float, float]:
    """Return the share up to `most` of the previous picture in some frames, or in all, without which `levels`
    (frames, P) contradict each other least, and what is `off` then.
    """

    def left(share: float) -> float:
        return off(without_previous(plan, levels, share, frames))

    found = minimize_scalar(left, bounds=(0, most), method="bounded", options={"xatol": 1e-3})
    return float(found.x), float(found.fun)


def without_previous(
    plan: SequencePlan, levels: Floats32, share: float, frames: Collection[int] | None = None
) -> Floats32:
    """Return the frames (frames, P) without a share of the previous picture in some of them, or in all; the picture
    before the first one is dark.
    """
    pictures: Floats32 = levels.copy()
    for frame in range(len(levels)) if frames is None else frames:
        place = plan.shown.index(frame)
        pictures[frame] /= np.float32(1 - share)
        if place:
            pictures[frame] -= np.float32(share / (1 - share)) * pictures[plan.shown[place - 1]]
    return pictures


def sums_off(levels: Floats32, groups: Sequence[Sequence[int]]) -> Floats32:
    """Return how far the sums of groups of frames are from the usual one, (groups, P)."""
    sums = np.stack([np.sum(levels[list(frames)], axis=0) for frames in groups])
    return sums - medians(sums, axis=0)
