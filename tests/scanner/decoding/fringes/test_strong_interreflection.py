"""Interreflection exceeds the direct light: pixels are certain or masked, never wrong."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.decoding import MaskReason, plan_sequence
from scanner.decoding.codes import interval_of
from scanner.decoding.fringes.phase_unwrapping import Tolerances, Wrapped, resolve_contradictory_codes, unwrap
from scanner.patterns import PRESETS, Code, Xor, gray_sequence, phase_sequence, xor_sequence
from tests.support.synthetic_capture import Scene

# At most six times as much indirect as direct light.
SCENE = Scene(camera=(420, 315), projector=(600, 400), indirect=6.0, exposure=50.0)
CONCAVE = PRESETS["concave"]
GROSS_PX = 2.0

LENGTH, CELL, PERIODS = 640, 8, (8.43, 6.1)
PLAN = plan_sequence(
    (
        *gray_sequence("x", LENGTH, CELL, inverses=False),
        *(p for p in xor_sequence("x", LENGTH, CELL, inverses=False) if isinstance(p, Xor)),
        *(p for period in PERIODS for p in phase_sequence("x", period, 4)),
        *gray_sequence("y", 8, 1),
    ),
    (LENGTH, 8),
).x
TOLERANCES = Tolerances(0.3, (0.05,))


def wrong_and_kept(code: Code) -> tuple[float, float]:
    """Return the share of matches wrong by a stripe or more, and the share of well lit pixels that are matched."""
    decoding = SCENE.decode(replace(CONCAVE, code=code).patterns(SCENE.projector))
    errors = np.abs(SCENE.errors(decoding)).max(axis=1)
    return float(np.mean(errors > GROSS_PX)), float(np.mean(decoding.reasons[SCENE.well_lit()] == MaskReason.KEPT))


def test_agreeing_codes_are_not_wrong() -> None:
    wrong, kept = wrong_and_kept(CONCAVE.code)
    assert CONCAVE.code == "both"
    assert wrong < 2e-4
    assert 0.85 < kept < 0.98


def test_a_single_gray_code_is_wrong_where_light_inverts_its_bits() -> None:
    wrong, kept = wrong_and_kept("gray")
    assert 2e-3 < wrong < 0.05
    assert 0.85 < kept < 0.98


@given(
    x=st.floats(10, LENGTH - 10),
    wrong_code=st.sampled_from([0, 1]),
    cells_off=st.integers(-70, 70).filter(lambda cells: abs(cells) > 1),
)
def test_the_fringes_choose_between_two_codes(x: float, wrong_code: int, cells_off: int) -> None:
    cell = int((x + 0.5) // CELL)
    wrong = (cell + cells_off) % (LENGTH // CELL)
    numbers = np.full((2, 1), cell, np.uint32)
    numbers[wrong_code] = wrong
    words = numbers ^ numbers >> np.uint32(1)
    positions = np.array([[x % period] for period in PERIODS], np.float32)
    wrapped = Wrapped(positions, np.full((2, 1), 1e-4, np.float32))
    interval = interval_of(PLAN, list(words), 1)
    if not interval.contradictory[0]:
        return
    orders = unwrap(PLAN, interval, wrapped, TOLERANCES)
    resolve_contradictory_codes(PLAN, list(words), wrapped, TOLERANCES, interval, orders)
    if interval.contradictory[0]:
        # The fringes agree with the wrong cell as well: their beat repeats there.
        near = np.arange(wrong * CELL - 3, (wrong + 1) * CELL + 3, 0.05)
        misses = [np.abs((near - x + period / 2) % period - period / 2) for period in PERIODS]
        assert np.min(np.max(misses, axis=0)) < 0.5
    else:
        assert orders.coordinates[:, 0] == pytest.approx(x, abs=0.01)
        assert interval.low[0] - 2.5 < x < interval.high[0] + 2.5


@given(x=st.floats(10, LENGTH - 10))
def test_a_misread_common_bit_of_both_codes_causes_no_wrong_matches(x: float) -> None:
    cell = np.uint32((x + 0.5) // CELL)
    word = np.array([cell ^ cell >> np.uint32(1)], np.uint32)
    words = [code.relative_to_base(code.relative_to_base(word) ^ np.uint32(1)) for code in PLAN.codes]
    assert not np.array_equal(words[0], words[1])
    positions = np.array([[x % period] for period in PERIODS], np.float32)
    wrapped = Wrapped(positions, np.full((2, 1), 1e-4, np.float32))
    interval = interval_of(PLAN, words, 1)
    orders = unwrap(PLAN, interval, wrapped, TOLERANCES)
    resolve_contradictory_codes(PLAN, words, wrapped, TOLERANCES, interval, orders)
    if not interval.contradictory[0]:
        assert orders.coordinates[:, 0] == pytest.approx(x, abs=0.01)
