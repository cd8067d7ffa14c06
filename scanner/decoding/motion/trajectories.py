"""Observations of a motion with a given trajectory in time, from the fringes of a capture."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints, median
from scanner.decoding.motion.fringe_fit import FringeFit
from scanner.decoding.motion.pixels import Pixels
from scanner.decoding.samples import TileSample
from scanner.decoding.sequence_plan import Fringe, SequencePlan

# Successive fringes observe a motion between them if their responses to it differ by at least this.
_LEAST_RESPONSE_DIFFERENCE = 0.05
# Errors from nonlinear brightness curves and interreflection grow with the period: a much longer one is useless.
_COMPARABLE = 4.0


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
            share: Floats = (times - self.first) / (self.last - self.first)
            return share
        return (times >= self.last).astype(np.float64)


# The fringes of x and of y, longest first.
FringeFits = tuple[tuple[FringeFit, ...], tuple[FringeFit, ...]]


@dataclass(frozen=True)
class MotionObservations:
    """Observed motion: `motion_px` with its `precision` (M,).

    `row` (M,): the coordinate observed, numbered by the P pixels for x, then by the same for y.
    """

    motion_px: Floats
    precision: Floats
    row: Ints


def fits_of(plan: SequencePlan, tiles: TileSample, pixels: Pixels) -> FringeFits:
    """Fit all fringes of a capture at the pixels."""

    def of(fringe: Fringe) -> FringeFit:
        times, shifts = plan.times_of(fringe)
        levels = tiles.of_frames(times.tolist(), pixels.number).astype(np.float64)
        return FringeFit(levels, shifts, fringe.period, pixels.noise, times)

    x, y = (tuple(map(of, axis.fringes)) for axis in plan.axes)
    return x, y


@dataclass(frozen=True)
class MotionObserver:
    """Fits of fringes that take a known motion, or none, into account; what remains can be observed."""

    fits: FringeFits
    pixels: Pixels

    def observe(self, trajectory: Trajectory) -> MotionObservations:
        """Return the motion along this trajectory that remains beside the known motion."""
        parts = []
        every = np.arange(len(self.pixels))
        for axis, (of_axis, apart) in enumerate(zip(self.fits, self._position_differences, strict=True)):
            responses = [one.response_to(trajectory.at(one.times)) for one in of_axis]
            found = [(one.motion_px, one.precision) for one in responses]
            for (before, after), known in zip(pairwise(responses), apart, strict=True):
                if known is not None:
                    found.append(_motion_between(*known, after.response - before.response))
            parts += [(*part, every + axis * len(every)) for part in found]
        motion_px, precision, row = (np.concatenate(column) for column in zip(*parts, strict=True))
        is_informative = precision > 0
        return MotionObservations(motion_px[is_informative], precision[is_informative], row[is_informative])

    @cached_property
    def _position_differences(self) -> tuple[list[tuple[Floats, Floats] | None], ...]:
        """For x and y, per two successive fringes: the difference of their positions (P,), and its variance.

        Besides noise, the variance contains the scatter within a tile due to interreflection and nonlinear brightness
        curves. None if one period is much longer than the other.
        """
        found = []
        for axis, of_axis in enumerate(self.fits):
            of_pairs: list[tuple[Floats, Floats] | None] = []
            # With a known motion, every fringe gives the position before it: the longest as well as the others.
            longest = of_axis[0]
            coordinate = _nearest(longest, self.pixels.projector_px[:, axis] - longest.mean_moved_px)
            for longer, shorter in pairwise(of_axis):
                nearest = _nearest(shorter, coordinate)
                of_pairs.append(
                    _with_variance(nearest - coordinate, longer.variance + shorter.variance, self.pixels.tile)
                    if longer.period <= _COMPARABLE * shorter.period
                    else None
                )
                coordinate = nearest
            found.append(of_pairs)
        return tuple(found)


def _with_variance(apart_px: Floats, noise: Floats, tile: Ints) -> tuple[Floats, Floats]:
    within = apart_px - _median_of_group(apart_px, tile)
    spread = median(np.abs(within)) * SIGMA_PER_MEDIAN
    return apart_px, noise + max(spread**2 - median(noise), 0.0)


def _motion_between(apart_px: Floats, variance: Floats, response: Floats) -> tuple[Floats, Floats]:
    """Return the motion and its precision (P,) from the difference of the positions of two fringes (P,).

    `response` (P,): how much more the second position follows a motion than the first.
    """
    is_informative = np.abs(response) > _LEAST_RESPONSE_DIFFERENCE
    return np.where(is_informative, apart_px / np.where(is_informative, response, 1.0), 0.0), np.where(
        is_informative, response**2 / variance, 0.0
    )


def _nearest(fit: FringeFit, target: Floats) -> Floats:
    """Return the coordinates (P,) nearest to the target with the fit's positions within the period."""
    nearest: Floats = fit.position + fit.period * np.rint((target - fit.position) / fit.period)
    return nearest


def _median_of_group(values: Floats, group: Ints) -> Floats:
    """Return for each value (P,) the median of its group; the groups are in order."""
    ordered = values[np.lexsort((values, group))]
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    counts = np.diff(starts, append=len(values))
    return np.repeat((ordered[starts + (counts - 1) // 2] + ordered[starts + counts // 2]) / 2, counts)
