"""Fringe orders: from wrapped phases, longest period first, on top of the interval that the Gray codes leave.

For every order of the longest fringe that falls in the interval, the shorter ones are followed down to the shortest.
How far outside the interval it lies, and how far each fringe is from the one before it, are measured in standard
deviations: the noise's, and what the capture shows beyond it. The order with the smallest sum of squares is taken; two
that are nearly as good decide nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import numpy as np

from calib.arrays import Bools
from scanner.decoding.arrays import Floats32
from scanner.decoding.codes import Interval
from scanner.decoding.plan import AxisPlan

# Disagreements of more than this many standard deviations contradict.
_LIMIT = 5.0
# An order is unique if the next best is this much worse: 9 is a likelihood ratio of about 100.
_CLEAR_MARGIN = 9.0
# The median of |x| for a normal distribution of standard deviation 1.
GAUSSIAN_MEDIAN = 0.6745
_FEWEST = 50


@dataclass(frozen=True)
class Wrapped:
    """Positions of a fringe within its period, 0 … period, and their variances; arrays of one shape."""

    position: Floats32
    variance: Floats32


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations beyond the noise, in projector pixels.

    `interval_px`: of the edges of the interval. `fringe_px`: of each shorter fringe against the one before it.
    """

    interval_px: float
    fringe_px: tuple[float, ...]


@dataclass(frozen=True)
class Orders:
    """`coordinates`: per fringe, longest first, in projector pixels. `excess`: how far outside the interval.

    `agree`: some order explains all the phases and the interval; where none does, coordinates mean nothing.
    `unique`: no other order explains them nearly as well; one element where there is none within reach.
    """

    coordinates: list[Floats32]
    excess: Floats32
    agree: Bools
    unique: Bools

    @property
    def certain(self) -> Bools:
        """Where one order agrees and no other."""
        return self.agree if self.unique.size == 1 and self.unique.all() else self.agree & self.unique

    def __getitem__(self, chosen: Bools) -> "Orders":
        """The orders at the pixels of a mask."""
        coordinates = [coordinate[chosen] for coordinate in self.coordinates]
        unique = np.broadcast_to(self.unique, chosen.shape)[chosen]
        return Orders(coordinates, self.excess[chosen], self.agree[chosen], unique)

    def distances(self) -> list[Floats32]:
        """How far each shorter fringe is from the one before it, in projector pixels."""
        return [np.abs(shorter - longer) for longer, shorter in pairwise(self.coordinates)]


def widest_tolerances(plan: AxisPlan) -> Tolerances:
    """What to begin with: as much as still separates neighbouring orders."""
    if not plan.fringes:
        return Tolerances(0.0, ())
    longest = plan.fringes[0].period
    slack = (longest - plan.cell) / 2 if longest > plan.cell else 0.0
    interval = max(0.9 * slack, 0.1 * plan.cell) if plan.codes else 0.02 * plan.length
    return Tolerances(interval / _LIMIT, tuple(fringe.period / 2 / _LIMIT for fringe in plan.fringes[1:]))


def measured_tolerances(plan: AxisPlan, orders: Orders, variances: Sequence[Floats32]) -> Tolerances:
    """Tolerances from the disagreements of a sample that was unwrapped with the widest ones.

    `variances`: per fringe, those of the sample's pixels.
    """
    widest = widest_tolerances(plan)
    interval = widest.interval_px
    outside = orders.excess[orders.excess > 0]
    if plan.codes and len(outside) >= _FEWEST:
        floor = max(0.1, 0.005 * plan.cell)
        interval = min(interval, max(floor, float(np.median(outside)) / GAUSSIAN_MEDIAN))
    between = []
    noises = [np.median(a + b) if len(a) else 0.0 for a, b in pairwise(variances)]
    for most, distance, noise in zip(widest.fringe_px, orders.distances(), noises, strict=True):
        sigma = most
        if len(distance) >= _FEWEST:
            total = float(np.median(distance)) / GAUSSIAN_MEDIAN
            sigma = min(most, sqrt(max(total**2 - float(noise), 0.1 * total**2)))
        between.append(max(sigma, 1e-3))
    return Tolerances(interval, tuple(between))


def unwrap(plan: AxisPlan, interval: Interval, wrapped: Sequence[Wrapped], tolerances: Tolerances) -> Orders:
    """The orders of the fringes of an axis, `wrapped` from the longest period to the shortest."""
    longest = np.float32(plan.fringes[0].period)
    reach = float(np.max(interval.half)) + _LIMIT * tolerances.interval_px
    others = int(2 * reach / longest)
    if not others:
        # No more than one order is within reach, and that is the nearest.
        nearest = nearest_order(wrapped[0].position, interval.centre, plan.fringes[0].period)
        coordinates, cost, excess = _follow(plan, interval, nearest, wrapped, tolerances)
        return Orders(coordinates, excess, np.isfinite(cost), np.ones((1, 1), np.bool_))
    first = wrapped[0].position
    lowest = first + np.ceil((interval.centre - np.float32(reach) - first) / longest) * longest
    best, best_cost, excess = _follow(plan, interval, lowest.copy(), wrapped, tolerances)
    second_cost = np.full_like(best_cost, np.inf)
    for order in range(1, others + 1):
        found, cost, outside = _follow(plan, interval, lowest + np.float32(order) * longest, wrapped, tolerances)
        better = cost < best_cost
        second_cost = np.minimum(second_cost, np.maximum(cost, best_cost))
        for kept, new in zip([*best, best_cost, excess], [*found, cost, outside], strict=True):
            np.copyto(kept, new, where=better)
    return Orders(best, excess, np.isfinite(best_cost), ~(second_cost < best_cost + _CLEAR_MARGIN))


def nearest_order(position: Floats32, target: Floats32, period: float) -> Floats32:
    """The position within the period that is nearest to the target, of the same shape."""
    coordinate: Floats32 = target - position
    coordinate *= np.float32(1 / period)
    np.rint(coordinate, out=coordinate)
    coordinate *= np.float32(period)
    coordinate += position
    return coordinate


def _follow(
    plan: AxisPlan, interval: Interval, first: Floats32, wrapped: Sequence[Wrapped], tolerances: Tolerances
) -> tuple[list[Floats32], Floats32, Floats32]:
    """One order of the longest fringe followed to the shortest: coordinates, cost (inf if contradicted), excess."""
    excess: Floats32 = first - interval.centre
    np.abs(excess, out=excess)
    excess -= interval.half
    np.maximum(excess, np.float32(0), out=excess)
    cost = _cost(excess * excess, wrapped[0].variance, tolerances.interval_px)
    coordinates = [first]
    for fringe, (longer, shorter), tolerance in zip(
        plan.fringes[1:], pairwise(wrapped), tolerances.fringe_px, strict=True
    ):
        coordinate = nearest_order(shorter.position, coordinates[-1], fringe.period)
        square = coordinate - coordinates[-1]
        square *= square
        cost += _cost(square, longer.variance + shorter.variance, tolerance)
        coordinates.append(coordinate)
    return coordinates, cost, excess


def _cost(square: Floats32, variance: Floats32, tolerance: float) -> Floats32:
    """The square of a distance over its variance; infinite beyond the limit. Overwrites the square."""
    square /= variance + np.float32(tolerance * tolerance)
    np.copyto(square, np.float32(np.inf), where=square > np.float32(_LIMIT * _LIMIT))
    return square
