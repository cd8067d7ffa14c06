"""Temporal phase unwrapping: fringe orders from wrapped phases, longest period first, within the Gray code interval.

Each order of the longest fringe within the interval is followed through to the shortest fringe. The distance outside
the interval, and that of each fringe from the one before, are measured in standard deviations (noise plus a tolerance
measured from the capture). The order with the smallest sum of squares is chosen; if another is nearly as good, the
pixel is ambiguous.

Where two codes of an axis contradict each other, the fringes decide. Strong interreflection inverts the coarse bits of
a Gray code. It does not invert those of an XOR code, but all of these are uncertain along the edges of its fine
stripes. Fringes of two periods are too ambiguous to be a code of their own, yet hardly any wrong code agrees with them.
So two of the three must agree, and no other two on a different answer. (Gupta et al., CVPR 2011, keep what two of four
codes agree on.) The base bit of an XOR code is one frame for both codes. Where it is misread, both codes are wrong; so
its inverse is tried as well.

The loops are compiled. They have no branches and few arrays each, so that they run on eight pixels at once.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np

from calib.numerics import Bools, Floats32, Words, compiled, inlined, median, robust_sigma
from scanner.decoding.codes import Interval, interval_of
from scanner.decoding.mask_reasons import PixelFlags, Reasons
from scanner.decoding.sequence_plan import AxisPlan, GrayCode
from scanner.decoding.significance import FEWEST_PIXELS, REJECTED, SIGNIFICANT_SIGMAS

_Scalar = float | np.floating[Any]
_INFINITE, _ZERO, _HALF = np.float32(np.inf), np.float32(0), np.float32(0.5)


@dataclass(frozen=True)
class Wrapped:
    """Positions of each fringe within its period, 0 … period, and their variances; (fringes, P), longest first."""

    positions: Floats32
    variances: Floats32


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations beyond the noise, in projector pixels.

    `interval_px`: of the ends of the interval. `fringe_px`: of each shorter fringe relative to the one before it.
    """

    interval_px: float
    fringe_px: tuple[float, ...]


@dataclass(frozen=True)
class Orders:
    """Unwrapped fringes."""

    coordinates: Floats32
    """(fringes, P): longest period first, in projector pixels."""
    flags: Reasons
    """(P,): of `PixelFlags`. DISAGREES: no order explains all phases and the interval, the coordinates are invalid.
    AMBIGUOUS: another order explains them nearly as well.
    """

    @property
    def agree(self) -> Bools:
        """(P,): True where the coordinates are valid."""
        agree: Bools = self.flags & np.uint8(PixelFlags.DISAGREES) == 0
        return agree


@dataclass(frozen=True)
class Disagreements:
    """Distances at pixels whose orders agree.

    `outside_px` (P,): of the longest fringe from the interval. `between_px` (fringes − 1, P): of each shorter fringe
    from the one before it.
    """

    outside_px: Floats32
    between_px: Floats32


def disagreements(orders: Orders, interval: Interval, chosen: Bools) -> Disagreements:
    """Return the disagreements at the `chosen` pixels."""
    coordinates, low, high = (np.compress(chosen, of, -1) for of in (orders.coordinates, interval.low, interval.high))
    outside_px = np.maximum(np.maximum(low - coordinates[0], coordinates[0] - high), _ZERO)
    return Disagreements(outside_px, np.abs(np.diff(coordinates, axis=0)))


def widest_tolerances(plan: AxisPlan) -> Tolerances:
    """Return the initial tolerances: the largest that still separate neighbouring orders."""
    longest = plan.fringes[0].period
    slack = (longest - plan.cell) / 2 if longest > plan.cell else 0.0
    interval = max(0.9 * slack, 0.1 * plan.cell) if plan.codes else 0.02 * plan.length
    between = tuple(fringe.period / 2 / SIGNIFICANT_SIGMAS for fringe in plan.fringes[1:])
    return Tolerances(interval / SIGNIFICANT_SIGMAS, between)


def measured_tolerances(plan: AxisPlan, distances: Disagreements, variances: Floats32) -> Tolerances:
    """Return the tolerances estimated from a sample that was unwrapped with the widest ones.

    `variances` (fringes, P): those of the sample's pixels.
    """
    widest = widest_tolerances(plan)
    interval = widest.interval_px
    outside = distances.outside_px[distances.outside_px > 0]
    if plan.codes and len(outside) >= FEWEST_PIXELS:
        floor = max(0.1, 0.005 * plan.cell)
        interval = min(interval, max(floor, robust_sigma(outside)))
    between = []
    noises = [median(a + b) if len(a) else 0.0 for a, b in pairwise(variances)]
    for most, distance, noise in zip(widest.fringe_px, distances.between_px, noises, strict=True):
        sigma = most
        if len(distance) >= FEWEST_PIXELS:
            total = robust_sigma(distance)
            sigma = min(most, sqrt(max(total**2 - float(noise), 0.1 * total**2)))
        between.append(max(sigma, 1e-3))
    return Tolerances(interval, tuple(between))


def unwrap(plan: AxisPlan, interval: Interval, wrapped: Wrapped, tolerances: Tolerances) -> Orders:
    """Unwrap the fringes of an axis."""
    periods = [np.float32(fringe.period) for fringe in plan.fringes]
    positions = wrapped.positions
    reach = plan.cell / 2 + SIGNIFICANT_SIGMAS * tolerances.interval_px
    further = int(2 * reach / plan.fringes[0].period)
    # With a single order within reach, it is the nearest.
    search = np.float32(reach if further else plan.fringes[0].period / 2)
    coordinates = np.empty_like(positions)
    _first_order(positions[0], periods[0], search, interval.low, interval.high, coordinates[0])
    best_cost = _followed(coordinates, interval, wrapped, periods, tolerances)
    if not further:
        return Orders(coordinates, (best_cost == _INFINITE) * np.uint8(PixelFlags.DISAGREES))
    best, second_cost, trial = coordinates[0], np.full_like(best_cost, np.inf), coordinates.copy()
    for _ in range(further):
        trial[0] += periods[0]
        cost = _followed(trial, interval, wrapped, periods, tolerances)
        _choose(trial[0], cost, best, best_cost, second_cost)
    _followed(coordinates, interval, wrapped, periods, tolerances)
    flags = (best_cost == _INFINITE) * np.uint8(PixelFlags.DISAGREES)
    flags |= (second_cost < best_cost + np.float32(REJECTED)) * np.uint8(PixelFlags.AMBIGUOUS)
    return Orders(coordinates, flags)


def _followed(
    coordinates: Floats32, interval: Interval, wrapped: Wrapped, periods: Sequence[np.float32], tolerances: Tolerances
) -> Floats32:
    """Fill in the `coordinates` (fringes, P) of the shorter fringes from the longest one, which is given.

    Returns the cost (P,), infinite where fringes or interval contradict.
    """
    positions, variances = wrapped.positions, wrapped.variances
    cost: Floats32 = np.empty_like(coordinates[0])
    tolerance_px2, most = np.float32(tolerances.interval_px**2), np.float32(SIGNIFICANT_SIGMAS**2)
    _cost_outside(coordinates[0], interval.low, interval.high, variances[0], tolerance_px2, most, cost)
    for k, tolerance in enumerate(tolerances.fringe_px, start=1):
        of_pair = variances[k - 1], variances[k], periods[k], np.float32(tolerance**2)
        _follow(positions[k], *of_pair, most, coordinates[k - 1], coordinates[k], cost)
    return cost


@inlined
def in_nearest_cycle(position: _Scalar, near: _Scalar, period: _Scalar) -> _Scalar:
    """Unwrap a position within a period to the cycle in which it is nearest to a coordinate."""
    nearest: _Scalar = position + np.rint((near - position) / period) * period
    return nearest


@compiled
def _first_order(
    position: Floats32, period: np.float32, search: np.float32, low: Floats32, high: Floats32, coordinate: Floats32
) -> None:
    """Compute the lowest coordinate with this position that is at most `search` below the middle of the interval."""
    for i in range(len(position)):
        start = _HALF * (low[i] + high[i]) - search
        coordinate[i] = position[i] + np.ceil((start - position[i]) / period) * period


@compiled
def _cost_outside(
    coordinate: Floats32,
    low: Floats32,
    high: Floats32,
    variance: Floats32,
    tolerance_px2: np.float32,
    most: np.float32,
    cost: Floats32,
) -> None:
    """Compute the cost of the distance from the interval; more than `most` contradicts it."""
    for i in range(len(coordinate)):
        distance = max(max(low[i] - coordinate[i], coordinate[i] - high[i]), _ZERO)
        square = distance * distance / (variance[i] + tolerance_px2)
        cost[i] = square if square <= most else _INFINITE


@compiled
def _follow(
    position: Floats32,
    longer_variance: Floats32,
    variance: Floats32,
    period: np.float32,
    tolerance_px2: np.float32,
    most: np.float32,
    longer: Floats32,
    shorter: Floats32,
    cost: Floats32,
) -> None:
    """Unwrap one fringe by the next longer one, and add the cost of their distance; more than `most` contradicts it."""
    for i in range(len(position)):
        nearest = in_nearest_cycle(position[i], longer[i], period)
        distance = nearest - longer[i]
        square = distance * distance / (longer_variance[i] + variance[i] + tolerance_px2)
        cost[i] += square if square <= most else _INFINITE
        shorter[i] = nearest


@compiled
def _choose(order: Floats32, cost: Floats32, best: Floats32, best_cost: Floats32, second_cost: Floats32) -> None:
    """Keep the cheaper order, and the cost of the second best."""
    for i in range(len(order)):
        second_cost[i] = min(second_cost[i], max(cost[i], best_cost[i]))
    for i in range(len(order)):
        best[i] = order[i] if cost[i] < best_cost[i] else best[i]
        best_cost[i] = min(cost[i], best_cost[i])


def resolve_contradictory_codes(
    plan: AxisPlan,
    words: Sequence[Words],
    wrapped: Wrapped,
    tolerances: Tolerances,
    interval: Interval,
    orders: Orders,
) -> None:
    """Resolve contradictions between codes, from the words (P,) of each, where the fringes agree with exactly one of
    them.

    That code's interval and fringe orders replace those of all codes together, in `interval` and `orders`.
    """
    if len(plan.codes) < 2 or not interval.contradictory.any():
        return
    where = np.flatnonzero(interval.contradictory)
    there = Wrapped(wrapped.positions[:, where], wrapped.variances[:, where])
    answers = list(_answers(plan, [of_code[where] for of_code in words]))
    followed = [unwrap(plan, answer, there, tolerances) for answer in answers]
    agrees = np.array([f.flags | answer.flags for f, answer in zip(followed, answers, strict=True)]) == 0
    coordinates = np.stack([f.coordinates[-1] for f in followed])
    first, last = (
        end(np.where(agrees, coordinates, np.float32(np.nan)), axis=0) for end in (np.fmin.reduce, np.fmax.reduce)
    )
    # NaN, and so not clear, where none agrees.
    is_clear = last - first < np.float32(plan.fringes[-1].period / 2)
    best = np.argmax(agrees, axis=0)
    for number, (answer, orders_of) in enumerate(zip(answers, followed, strict=True)):
        chosen = is_clear & (best == number)
        at = where[chosen]
        interval.low[at], interval.high[at] = answer.low[chosen], answer.high[chosen]
        orders.coordinates[:, at] = orders_of.coordinates[:, chosen]
        interval.flags[at] = orders.flags[at] = 0


def _answers(plan: AxisPlan, words: Sequence[Words]) -> Iterator[Interval]:
    """Yield the interval of each code by itself, then that of the codes that share an XOR base with
    this bit inverted.
    """
    for code, of_code in zip(plan.codes, words, strict=True):
        yield interval_of(replace(plan, codes=(code,)), [of_code], len(of_code))
    for base_code in plan.codes:
        if base_code.base is None:
            continue
        sharing = [
            (code, _misread(code, base_code.base, of_code))
            for code, of_code in zip(plan.codes, words, strict=True)
            if (code.bits, code.cell, code.offset) == (base_code.bits, base_code.cell, base_code.offset)
        ]
        codes, otherwise = zip(*sharing, strict=True)
        yield interval_of(replace(plan, codes=codes), otherwise, len(otherwise[0]))


def _misread(code: GrayCode, bit: int, words: Words) -> Words:
    """Return the words (P,) with one bit, as shown, inverted."""
    return code.relative_to_base(code.relative_to_base(words) ^ words.dtype.type(1 << code.bits - 1 - bit))
