"""Fringe orders from beating fringes and codes, and the tolerances by which they are chosen."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.decoding import AxisPlan, Fringe, PixelFlags, plan_sequence
from scanner.decoding.codes import interval_of
from scanner.decoding.fringes.phase_unwrapping import (
    Disagreements,
    Tolerances,
    Wrapped,
    measured_tolerances,
    unwrap,
    widest_tolerances,
)
from scanner.patterns import Pattern, gray_sequence, phase_sequence


def axis(length: int, *periods: float) -> AxisPlan:
    return AxisPlan("x", length, (), tuple(Fringe("x", period, (0.0, 1 / 3, 2 / 3), (0, 1, 2)) for period in periods))


@given(st.floats(0, 1279), st.integers(0, 2**32 - 1))
def test_beating_fringes_are_unwrapped_over_the_whole_axis(x: float, seed: int) -> None:
    plan = axis(1280, 21.0, 20.0, 19.0)
    noise = np.random.default_rng(seed).normal(0, 0.05, 3)
    positions = [[(x + e) % f.period] for f, e in zip(plan.fringes, noise, strict=True)]
    wrapped = Wrapped(np.array(positions, np.float32), np.full((3, 1), 0.0025, np.float32))
    interval = interval_of(plan, [], 1)
    orders = unwrap(plan, interval, wrapped, Tolerances(1.0, (0.05, 0.05)))
    assert orders.agree.all()
    assert abs(orders.coordinates[-1][0] - x) < 0.4


def test_equally_likely_fringe_orders_stay_undecided() -> None:
    plan = plan_sequence([*gray_sequence("x", 256, 16), *gray_sequence("y", 8, 1)], (256, 8)).x
    plan = replace(plan, fringes=axis(256, 8.0).fringes)
    interval = interval_of(plan, [np.array([3 ^ 3 >> 1], np.uint8)], 1)
    wrapped = Wrapped(np.full((1, 1), 5.0, np.float32), np.full((1, 1), 0.01, np.float32))
    orders = unwrap(plan, interval, wrapped, Tolerances(0.2, ()))
    assert orders.flags.tolist() == [PixelFlags.AMBIGUOUS], "53 and 61 are both between 47.5 and 63.5"


@pytest.mark.parametrize(
    ("cell", "outside_px", "interval_px"),
    [
        (16, 0.6, 0.6),  # as measured
        (16, 0.01, 0.1),  # a tenth of a pixel at least
        (64, 0.01, 0.32),  # or a two-hundredth of a cell
        (16, 50.0, np.inf),  # and no more than separates orders
    ],
)
def test_the_tolerance_of_an_interval_is_relative_to_its_bounds(
    cell: int, outside_px: float, interval_px: float
) -> None:
    patterns: list[Pattern] = [
        *gray_sequence("x", 1024, cell),
        *phase_sequence("x", 4 * cell, 4),
        *gray_sequence("y", 8, 1),
    ]
    plan = plan_sequence(patterns, (1024, 8)).x
    rng = np.random.default_rng(0)
    outside = np.concatenate([np.abs(rng.normal(0, outside_px, 20_000)), np.zeros(30_000)]).astype(np.float32)
    found = Disagreements(outside, np.zeros((0, len(outside)), np.float32))
    tolerances = measured_tolerances(plan, found, np.zeros((1, len(outside)), np.float32))
    expected = min(interval_px, widest_tolerances(plan).interval_px)
    assert tolerances.interval_px == pytest.approx(expected, rel=0.02)
