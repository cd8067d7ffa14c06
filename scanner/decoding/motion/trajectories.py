"""What the fringes of a capture say of a motion that takes a certain course in time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints, median
from scanner.decoding.motion.fringe_fit import FringeFit
from scanner.decoding.motion.pixels import Pixels
from scanner.decoding.motion.tile_sample import TileSample
from scanner.decoding.sequence_plan import SequencePlan

# Successive fringes tell of a motion between them if their positions follow it at least this differently.
_LEAST_RESPONSE_DIFFERENCE = 0.05
# What bent brightness curves and interreflection do grows with the period: one that is longer by far tells nothing.
_COMPARABLE = 4.0


@dataclass(frozen=True)
class Trajectory:
    """How far a motion has come: from 0 to 1 at once between the frames `first` and `last`, or evenly from the one to
    the other if it is `slow`.
    """

    first: int
    last: int
    slow: bool = False

    def at(self, times: Ints) -> Floats:
        """The share (N,) of the motion that is done in frames (N,)."""
        if self.slow:
            share: Floats = (times - self.first) / (self.last - self.first)
            return share
        return (times >= self.last).astype(np.float64)


@dataclass(frozen=True)
class FringeObservation:
    """All frames of a fringe, repeats among them: the fit to them, and when they were taken, `times` (N,)."""

    fit: FringeFit
    times: Ints

    def with_known_motion(self, trajectory: Trajectory, motion_px: Floats) -> "FringeObservation":
        """The same, told of a motion (P,) of its pixels."""
        return replace(self, fit=replace(self.fit, moved_px=trajectory.at(self.times)[:, None] * motion_px))


# For x and for y, those of its fringes, longest first.
FringeObservations = tuple[tuple[FringeObservation, ...], tuple[FringeObservation, ...]]


@dataclass(frozen=True)
class MotionObservations:
    """What pixels say of a motion: `motion_px` with its `precision` (M,), and which says it: its `row` (M,) among the P
    pixels for x, then the same for y.
    """

    motion_px: Floats
    precision: Floats
    row: Ints


def observations_of(plan: SequencePlan, tiles: TileSample, pixels: Pixels) -> FringeObservations:
    """Those of a capture."""

    def of(frames: Sequence[int], shifts: Sequence[float], period: float) -> FringeObservation:
        taken = [
            (shift, time)
            for shift, frame in zip(shifts, frames, strict=True)
            for time, number in enumerate(plan.shown)
            if number == frame
        ]
        times = np.array([time for _, time in taken])
        levels = tiles.levels(times.tolist(), pixels.number).astype(np.float64)
        return FringeObservation(
            FringeFit(levels, np.array([shift for shift, _ in taken]), period, pixels.noise), times
        )

    x, y = (tuple(of(each.frames, each.shifts, each.period) for each in axis.fringes) for axis in plan.axes)
    return x, y


@dataclass(frozen=True)
class MotionObserver:
    """The fringes, told of a motion, if only of none. What is left they tell."""

    observations: FringeObservations
    pixels: Pixels

    def observe(self, trajectory: Trajectory) -> MotionObservations:
        """What they say of a motion of this course, beyond that of which they were told."""
        parts = []
        every = np.arange(len(self.pixels))
        for axis, (of_axis, apart) in enumerate(zip(self.observations, self._position_differences, strict=True)):
            responses = [one.fit.response_to(trajectory.at(one.times)) for one in of_axis]
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
        """Of x and y, per two successive fringes: how far their positions are apart (P,), and the variance of that.

        Beside noise, they are apart by what interreflection and bent brightness curves do to each, which varies in a
        tile. None where one period is longer by far.
        """
        found = []
        for axis, of_axis in enumerate(self.observations):
            of_pairs: list[tuple[Floats, Floats] | None] = []
            # Told of a motion, every fringe puts a pixel where it was before: the longest as well as the others.
            longest = of_axis[0].fit
            coordinate = _nearest(longest, self.pixels.projector_px[:, axis] - longest.mean_moved_px)
            for longer, shorter in pairwise(one.fit for one in of_axis):
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
    """What two fringes say by how far their positions are apart (P,): the motion, and its precision (P,).

    `response` (P,): by how much the second follows a motion more than the first.
    """
    is_informative = np.abs(response) > _LEAST_RESPONSE_DIFFERENCE
    return np.where(is_informative, apart_px / np.where(is_informative, response, 1.0), 0.0), np.where(
        is_informative, response**2 / variance, 0.0
    )


def _nearest(fit: FringeFit, target: Floats) -> Floats:
    """The coordinates (P,) with the fit's positions within the period that are nearest to the target."""
    nearest: Floats = fit.position + fit.period * np.rint((target - fit.position) / fit.period)
    return nearest


def _median_of_group(values: Floats, group: Ints) -> Floats:
    """For each value (P,) the median of those of its group; the groups are in order."""
    ordered = values[np.lexsort((values, group))]
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    counts = np.diff(starts, append=len(values))
    return np.repeat((ordered[starts + (counts - 1) // 2] + ordered[starts + counts // 2]) / 2, counts)
