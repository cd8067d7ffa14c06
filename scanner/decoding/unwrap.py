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
    `unique`: no other order explains them nearly as well.
    """

    coordinates: list[Floats32]
    excess: Floats32
    agree: Bools
    unique: Bools

    def __getitem__(self, chosen: Bools) -> "Orders":
        """The orders at the pixels of a mask."""
        coordinates = [coordinate[chosen] for coordinate in self.coordinates]
        return Orders(coordinates, self.excess[chosen], self.agree[chosen], self.unique[chosen])

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
    reach = interval.half + np.float32(_LIMIT * tolerances.interval_px)
    first = wrapped[0].position
    lowest = first + np.ceil((interval.centre - reach - first) / longest) * longest
    best, best_cost, excess = _follow(plan, interval, lowest, wrapped, tolerances)
    second_cost = np.full_like(best_cost, np.inf)
    for order in range(1, int(2 * np.max(reach) / longest) + 1):
        found, cost, outside = _follow(plan, interval, lowest + np.float32(order) * longest, wrapped, tolerances)
        better = cost < best_cost
        second_cost = np.minimum(second_cost, np.maximum(cost, best_cost))
        for kept, new in zip([*best, best_cost, excess], [*found, cost, outside], strict=True):
            np.copyto(kept, new, where=better)
    return Orders(best, excess, np.isfinite(best_cost), ~(second_cost < best_cost + _CLEAR_MARGIN))


def _follow(
    plan: AxisPlan, interval: Interval, first: Floats32, wrapped: Sequence[Wrapped], tolerances: Tolerances
) -> tuple[list[Floats32], Floats32, Floats32]:
    """One order of the longest fringe followed to the shortest: coordinates, cost (inf if contradicted), excess."""
    excess: Floats32 = np.maximum(np.abs(first - interval.centre) - interval.half, np.float32(0))
    cost = _cost(excess, wrapped[0].variance, tolerances.interval_px)
    coordinates = [first.copy()]
    for fringe, (longer, shorter), tolerance in zip(
        plan.fringes[1:], pairwise(wrapped), tolerances.fringe_px, strict=True
    ):
        period = np.float32(fringe.period)
        coordinate = shorter.position + np.rint((coordinates[-1] - shorter.position) / period) * period
        cost += _cost(coordinate - coordinates[-1], longer.variance + shorter.variance, tolerance)
        coordinates.append(coordinate)
    return coordinates, cost, excess


def _cost(distance: Floats32, variance: Floats32, tolerance: float) -> Floats32:
    ratio = distance * distance
    ratio /= variance + np.float32(tolerance * tolerance)
    ratio[ratio > _LIMIT * _LIMIT] = np.inf
    return ratio
