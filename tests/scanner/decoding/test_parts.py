"""Single parts of the decoder with their own ground truth."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from scanner.decoding import saturation_level
from scanner.decoding.codes import cell_numbers, interval_of
from scanner.decoding.discontinuities import SMALLEST_PATCH, small_patches
from scanner.decoding.fringes.gamma_ripple import TABLE_LENGTH, straightening
from scanner.decoding.fringes.phase_unwrapping import Tolerances, Wrapped, unwrap
from scanner.decoding.mask_reasons import PixelFlags
from scanner.decoding.motion.code_shift import middle_of
from scanner.decoding.planning import plan_sequence, repeat_length
from scanner.decoding.sequence_plan import AxisPlan, Fringe
from scanner.patterns import Gray, Pattern, gray_sequence, phase_sequence


@given(st.integers(0, 2**32 - 1))
def test_cell_numbers_follow_the_pattern(n: int) -> None:
    assert cell_numbers(np.array([n ^ n >> 1], np.uint32))[0] == n


@given(cell=st.integers(1, 40), offset=st.integers(0, 100), length=st.integers(50, 700))
def test_the_interval_of_a_word_holds_the_pixel_that_shows_it(cell: int, offset: int, length: int) -> None:
    bits = int((length - 1 + offset) // cell).bit_length() or 1
    code = tuple(Gray("x", bit, bits, cell, offset) for bit in range(bits))
    plan = plan_sequence((*code, *gray_sequence("y", 8, 1)), (length, 8)).x
    x = np.arange(length, dtype=np.float64)
    word = np.sum([(p.brightness(x, x) > 0.5).astype(np.uint32) << (bits - 1 - p.bit) for p in code], axis=0)
    interval = interval_of(plan, [word.astype(np.uint32)], length)
    assert np.all(x >= interval.low + 0.5 - 1e-3)
    assert np.all(x <= interval.high - 0.5 + 1e-3)
    assert interval.possible.all()
    assert np.all(interval.high - interval.low <= cell)


def test_contradicting_codes_are_noted() -> None:
    codes = [Gray("x", bit, 6, 8, offset) for offset in (0, 4) for bit in range(6)]
    plan = plan_sequence([*codes, *gray_sequence("y", 8, 1)], (300, 8)).x
    # Cells 3 (24 to 31) and 3 or 4 (20 to 27, 28 to 35) overlap, cell 6 (44 to 51) overlaps neither; cell 40 begins at
    # 320.
    cells = np.array([[3, 3, 3, 40], [3, 4, 6, 40]], np.uint32)
    interval = interval_of(plan, list(cells ^ cells >> 1), 4)
    assert interval.flags[:3].tolist() == [0, 0, PixelFlags.CONTRADICTORY]
    assert (interval.flags & PixelFlags.OUTSIDE).tolist() == [0, 0, 0, PixelFlags.OUTSIDE]
    assert interval.low[:2].tolist() == [23.5, 27.5]
    assert interval.high[:2].tolist() == [27.5, 31.5]


def test_cells_of_two_codes_that_only_touch_leave_a_cell() -> None:
    codes = [Gray("x", bit, 6, 8, offset) for offset in (0, 8) for bit in range(6)]
    plan = plan_sequence([*codes, *gray_sequence("y", 8, 1)], (300, 8)).x
    # Cell 3 (24 to 31) is cell 4 of the second code, whose cell 5 begins where it ends.
    cells = np.array([[3, 3], [4, 5]], np.uint32)
    interval = interval_of(plan, list(cells ^ cells >> 1), 2)
    assert interval.possible.all()
    np.testing.assert_allclose(interval.variance(plan.cell), 64 / 12, rtol=1e-6)
    assert interval.centre.tolist() == [27.5, 31.5]


@given(
    shifts=st.lists(st.floats(-2, 2), min_size=3, max_size=9),
    phase=st.floats(0, 6.28),
    offset=st.floats(0, 200),
)
def test_the_weights_recover_a_fringe_from_any_shifts(shifts: list[float], phase: float, offset: float) -> None:
    fringe = Fringe("x", 16.0, tuple(shifts), tuple(range(len(shifts))))
    assume(fringe.noise_gain < 3 and np.linalg.matrix_rank(fringe.weights, tol=1e-3) == 3)
    levels = offset + 50 * np.cos(phase + 2 * np.pi * np.array(shifts))
    assert np.allclose(fringe.weights @ levels, [offset, 50 * np.cos(phase), 50 * np.sin(phase)], atol=1e-6)


@pytest.mark.parametrize("steps", [3, 4, 8, 16])
def test_the_noise_of_equal_shifts_matches_the_textbook_formula(steps: int) -> None:
    fringe = Fringe("x", 16.0, tuple(k / steps for k in range(steps)), tuple(range(steps)))
    assert fringe.noise_gain == pytest.approx(np.sqrt(2 / steps))


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


@given(
    image=arrays.arrays(np.bool_, st.tuples(st.integers(1, 30), st.integers(1, 40)), elements=st.booleans()),
    grown=st.integers(0, 2),
)
def test_small_patches_match_those_of_opencv(image: NDArray[np.bool_], grown: int) -> None:
    thick = cv2.dilate(image.view(np.uint8), np.ones((2, 2), np.uint8), iterations=grown).view(np.bool_)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thick.view(np.uint8), connectivity=4)
    expected = thick & (stats[labels, cv2.CC_STAT_AREA] < SMALLEST_PATCH)
    assert np.array_equal(small_patches(thick), expected)


def test_the_common_period_of_fringes() -> None:
    assert repeat_length([100, 100 / 1.5], 1920) == pytest.approx(200)
    assert repeat_length([16], 854) == 16
    assert repeat_length([1920], 1920) == np.inf
    assert repeat_length([21, 20, 19], 1280) == np.inf


@pytest.mark.parametrize(("steps", "gamma"), [(3, 1.6), (3, 2.2), (4, 1.6), (4, 3.0)])
def test_a_bent_phase_is_straightened(steps: int, gamma: float) -> None:
    fringe = Fringe("x", 16.0, tuple(0.1 + k / steps for k in range(steps)), tuple(range(steps)))
    truth = np.random.default_rng(1).uniform(0, 2 * np.pi, 40_000)
    light = (0.5 + 0.5 * np.cos(truth + 2 * np.pi * np.array(fringe.shifts)[:, None])) ** gamma
    _, cosine, sine = fringe.weights @ light
    measured = np.mod(np.arctan2(sine, cosine), 2 * np.pi).astype(np.float32)
    table = straightening(fringe, [measured])
    assert table is not None
    straight = measured + table[(measured * TABLE_LENGTH / (2 * np.pi)).astype(int) % TABLE_LENGTH]
    before, after = (np.std(np.angle(np.exp(1j * (phase - truth)))) for phase in (measured, straight))
    assert 1e-5 < after < before / 5
    assert after < 0.01


def test_a_straight_phase_is_left_alone() -> None:
    fringe = Fringe("x", 16.0, (0.0, 1 / 3, 2 / 3), (0, 1, 2))
    measured = np.random.default_rng(1).uniform(0, 2 * np.pi, 20_000).astype(np.float32)
    assert straightening(fringe, [measured]) is None


@pytest.mark.parametrize(
    ("peak", "level"),
    [(1023, 1023), (4095, 4095), (65535, 65535), (65520, 65520), (4000, np.inf), (900, np.inf)],
)
def test_the_saturation_of_16_bit_images(peak: int, level: float) -> None:
    assert saturation_level(np.array([[3, peak]], np.uint16)) == level


def test_the_saturation_of_8_bit_images() -> None:
    assert saturation_level(np.array([[3, 9]], np.uint8)) == 254


@given(
    turned=st.floats(-3.0, 3.0),
    width=st.floats(0.05, 0.95),
    kept=st.floats(0.5, 1.0),
    seed=st.integers(0, 99),
)
def test_the_middle_of_an_unevenly_filled_arc(turned: float, width: float, kept: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-width / 2, width / 2, 3000)
    turns = turns[(turns < width / 6) | (rng.uniform(size=len(turns)) < kept)]
    noisy = turned + 2 * np.pi * (turns + rng.normal(0, 0.003, len(turns)))
    off = np.angle(np.exp(1j * (middle_of(noisy.astype(np.float32), width) - turned))) / (2 * np.pi)
    assert abs(off) < 0.015


def test_every_frame_is_planned_once() -> None:
    patterns: list[Pattern] = [
        *gray_sequence("x", 300, 8),
        *phase_sequence("x", 16, 5),
        *gray_sequence("y", 200, 8, inverses=False),
    ]
    plan = plan_sequence(patterns, (300, 200))
    assert sorted([*plan.x.frames, *plan.y.frames]) == list(range(len(patterns)))
    assert len(plan.complements) == 6
