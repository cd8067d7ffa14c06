"""The frames of all fringes of a sequence: which place, axis and step each has, and what explains them at rest."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from calib.numerics import Floats, Ints
from scanner.decoding.sequence_plan import Fringe, SequencePlan

# Errors from nonlinear brightness curves and interreflection grow with the period: a much longer one is useless.
_COMPARABLE = 4.0


@dataclass(frozen=True)
class FringeFrames:
    """The N frames of F `fringes`, in the order of time; fringes are those of x, then of y, each from the longest.

    `times` (N,): places in the sequence, with repeats. `of_fringe` (N,): number of the fringe. `angles` (N, 1): of the
    phase steps.
    """

    fringes: tuple[Fringe, ...]
    times: Ints
    of_fringe: Ints
    angles: Floats

    @cached_property
    def axis(self) -> Ints:
        """(N,): 0 for x, 1 for y."""
        return np.array([fringe.axis == "y" for fringe in self.fringes], np.int64)[self.of_fringe]

    @cached_property
    def steepness(self) -> Floats:
        """(N, 1): radians of the phase per px of the coordinate."""
        return 2 * np.pi / np.array([fringe.period for fringe in self.fringes])[self.of_fringe, None]

    @cached_property
    def design(self) -> Floats:
        """(N, 1 + 2 F): derivatives of the frames by the light, which all fringes share, and by A cos θ and A sin θ of
        each fringe.
        """
        waves = np.concatenate([np.cos(self.angles), -np.sin(self.angles)], axis=1)
        own = (self.of_fringe[:, None] == np.arange(len(self.fringes)))[:, :, None] * waves[:, None]
        return np.concatenate([np.ones((len(own), 1)), own.reshape(len(own), -1)], axis=1)

    @cached_property
    def weights(self) -> Floats:
        """(1 + 2 F, N): least squares of the parameters of the design."""
        return np.asarray(np.linalg.pinv(self.design), np.float64)

    @property
    def shortest(self) -> tuple[int, int]:
        """Numbers of the shortest fringes of x and y."""
        return sum(fringe.axis == "x" for fringe in self.fringes) - 1, len(self.fringes) - 1

    @cached_property
    def successive(self) -> list[tuple[int, int]]:
        """Numbers of two fringes of an axis, the longer one first, whose periods are comparable."""
        return [
            (number, number + 1)
            for number, (longer, shorter) in enumerate(pairwise(self.fringes))
            if longer.axis == shorter.axis and longer.period <= _COMPARABLE * shorter.period
        ]


def fringe_frames(plan: SequencePlan) -> FringeFrames:
    """Return the frames of all fringes of a sequence, at least one."""
    shown = sorted(
        (int(time), number, float(shift))
        for number, fringe in enumerate(plan.fringes)
        for time, shift in zip(*plan.times_of(fringe), strict=True)
    )
    times, of_fringe, shifts = (np.array(column) for column in zip(*shown, strict=True))
    return FringeFrames(plan.fringes, times, of_fringe, 2 * np.pi * shifts[:, None])
