"""What the fringes of a capture say of a motion that takes a certain course in time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Floats, Ints
from scanner.decoding.motion.fringe_fit import Follows, FringeFit
from scanner.decoding.motion.pixels import Pixels
from scanner.decoding.motion.tile_sample import TileSample
from scanner.decoding.sequence_plan import SequencePlan

# Successive fringes tell of a motion between them if their positions follow it at least this differently.
_APART = 0.05
# What bent brightness curves and interreflection do grows with the period: one that is longer by far tells nothing.
_COMPARABLE = 4.0


@dataclass(frozen=True)
class Course:
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
class Showing:
    """All frames of a fringe, repeats among them: the fit to them, and when they were taken, `times` (N,)."""

    fit: FringeFit
    times: Ints

    def moved(self, course: Course, motion_px: Floats) -> "Showing":
        """The same, told of a motion (P,) of its pixels."""
        return replace(self, fit=replace(self.fit, moved_px=course.at(self.times)[:, None] * motion_px))


# For x and for y, those of its fringes, longest first.
Showings = tuple[tuple[Showing, ...], tuple[Showing, ...]]


@dataclass(frozen=True)
class Seen:
    """What pixels say of a motion: `motion_px`, its `precision` (M,), which `pixel` (M,) says it, and along which
    `axis` (M,).
    """

    motion_px: Floats
    precision: Floats
    pixel: Ints
    axis: Ints


def showings_of(plan: SequencePlan, tiles: TileSample, pixels: Pixels) -> Showings:
    """Those of a capture."""

    def of(frames: Sequence[int], shifts: Sequence[float], period: float) -> Showing:
        taken = [
            (shift, time)
            for shift, frame in zip(shifts, frames, strict=True)
            for time, number in enumerate(plan.shown)
            if number == frame
        ]
        times = np.array([time for _, time in taken])
        levels = tiles.levels(times.tolist(), pixels.number).astype(np.float64)
        return Showing(FringeFit(levels, np.array([shift for shift, _ in taken]), period, pixels.noise), times)

    x, y = (tuple(of(each.frames, each.shifts, each.period) for each in axis.fringes) for axis in plan.axes)
    return x, y


def told(showings: Showings, showings_moved: Showings, pixels: Pixels, course: Course) -> Seen:
    """What the fringes say of a motion of this course, beyond that of which they were told."""
    parts = []
    every = np.arange(len(pixels))
    for axis, of_axis in enumerate(showings_moved):
        follows = [one.fit.follow(course.at(one.times)) for one in of_axis]
        found = [(one.motion_px, one.precision) for one in follows]
        coordinate = _nearest(showings[axis][0].fit, pixels.projector_px[:, axis])
        for longer, shorter, before, after in zip(of_axis, of_axis[1:], follows, follows[1:], strict=False):
            nearest = _nearest(shorter.fit, coordinate)
            if longer.fit.period <= _COMPARABLE * shorter.fit.period:
                found.append(_between(nearest - coordinate, longer.fit, shorter.fit, before, after, pixels.tile))
            coordinate = nearest
        parts += [(*part, every, np.full(len(every), axis)) for part in found]
    motion_px, precision, pixel, axes = (np.concatenate(column) for column in zip(*parts, strict=True))
    says = precision > 0
    return Seen(motion_px[says], precision[says], pixel[says], axes[says])


def _between(
    apart_px: Floats, longer: FringeFit, shorter: FringeFit, before: Follows, after: Follows, tile: Ints
) -> tuple[Floats, Floats]:
    """What two fringes say by how far their positions are apart (P,): the motion, and its precision (P,).

    Beside noise, they are apart by what interreflection and bent brightness curves do to each, which varies in a tile.
    """
    noise = longer.variance + shorter.variance
    within = apart_px - _median_of_group(apart_px, tile)
    spread = float(np.median(np.abs(within))) * SIGMA_PER_MEDIAN
    response = after.response - before.response
    says = np.abs(response) > _APART
    variance = noise + max(spread**2 - float(np.median(noise)), 0.0)
    return np.where(says, apart_px / np.where(says, response, 1.0), 0.0), np.where(says, response**2 / variance, 0.0)


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
