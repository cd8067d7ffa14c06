"""The weights and the noise of a fringe, and frames that are planned once each."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from scanner.decoding.planning import plan_sequence, repeat_length
from scanner.decoding.sequence_plan import Fringe
from scanner.patterns import Pattern, gray_sequence, phase_sequence


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


def test_the_common_period_of_fringes() -> None:
    assert repeat_length([100, 100 / 1.5], 1920) == pytest.approx(200)
    assert repeat_length([16], 854) == 16
    assert repeat_length([1920], 1920) == np.inf
    assert repeat_length([21, 20, 19], 1280) == np.inf


def test_every_frame_is_planned_once() -> None:
    patterns: list[Pattern] = [
        *gray_sequence("x", 300, 8),
        *phase_sequence("x", 16, 5),
        *gray_sequence("y", 200, 8, inverses=False),
    ]
    plan = plan_sequence(patterns, (300, 200))
    assert sorted([*plan.x.frames, *plan.y.frames]) == list(range(len(patterns)))
    assert len(plan.complements) == 6
