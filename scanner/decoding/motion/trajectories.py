"""Trajectories of a motion in time."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.numerics import Floats, Ints


@dataclass(frozen=True)
class Trajectory:
    """The completed share of a motion over time, from 0 to 1.

    It is a step between the frames `first` and `last`, or a linear ramp from the one to the other if it is `slow`.
    """

    first: int
    last: int
    slow: bool = False

    def at(self, times: Ints) -> Floats:
        """Return the completed share (N,) of the motion in frames (N,)."""
        if self.slow:
            return (times - self.first) / (self.last - self.first)
        return (times >= self.last).astype(np.float64)


def trajectories_of(times: Ints) -> list[Trajectory]:
    """Return all that frames at these times (N,), in order, can tell apart: a slow drift, and bumps between two."""
    bumps = [Trajectory(int(first), int(last)) for first, last in pairwise(times)]
    return [Trajectory(int(times[0]), int(times[-1]), slow=True), *bumps]
