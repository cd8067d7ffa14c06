"""Whether a mix of patterns determines both coordinates is checked before the first frame, each planned once."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from scanner.decoding.decoder import Decoder
from scanner.decoding.planning import plan_sequence, repeat_length
from scanner.decoding.sequence_plan import Fringe
from scanner.errors import InputError
from scanner.patterns import (
    Axis,
    Black,
    Gray,
    Pattern,
    Phase,
    White,
    Xor,
    draw,
    gray_sequence,
    phase_sequence,
    sequence_for,
    xor_sequence,
)
from tests.support.synthetic_capture import fringes

AXES: tuple[Axis, ...] = ("x", "y")
SIZE = (300, 200)
X = tuple(gray_sequence("x", 300, 4))
Y = tuple(gray_sequence("y", 200, 4))


@pytest.mark.parametrize(
    ("patterns", "said"),
    [
        ((), "no pattern varies along x or y"),
        ((White(), Black()), "no pattern varies along x or y"),
        (X, "no pattern varies along y; .* or else the rig's calibration"),
        (Y, "no pattern varies along x; .* or else the rig's calibration"),
        ((*(p for p in X if p.bit != 3), *Y), "no frame shows bit 3"),
        ((*X, *(p for p in Y if p.bit not in (0, 5))), "no frame shows bit 0, 5"),
        ((*X, *Y, Phase("x", 16.0, 0.0), Phase("x", 16.0, 0.5)), "at least three"),
        ((*X, *Y, *(Phase("x", 16.0, shift) for shift in (0.0, 1.0, 0.5))), "at least three"),
        ((*X, *Y, *(Phase("x", 16.0, shift) for shift in (0.0, 0.01, 0.02))), "well spread"),
        (
            (*X, *phase_sequence("y", 16, 8)),
            "y coordinate is not determined: fringes of period 16 px repeat every 16 px",
        ),
        ((*fringes([100, 100 / 1.5], 3),), "repeat every 200 px"),
        ((*gray_sequence("x", 300, 32), *phase_sequence("x", 16, 8), *Y), "its Gray cells are 32 px long"),
        ((*(Gray("x", bit, 7, 2) for bit in range(7)), *Y), "counts from 0 to 149"),
        ((*(Gray("x", bit, 9, 1, -5) for bit in range(9)), *Y), "counts from -5 to 294"),
        ((*X, Gray("x", 9, 7, 4), *Y), "must be 0 … 6"),
        ((*(p for p in xor_sequence("x", 300, 4) if isinstance(p, Xor)), *Y), "needs its base as well, .* bit 6"),
        ((*(p for p in xor_sequence("x", 300, 4) if p.bit != 2), *Y), "no frame shows bit 2"),
    ],
)
def test_an_undetermined_mix_is_refused(patterns: tuple[Pattern, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Decoder(patterns, SIZE)


@pytest.mark.parametrize(
    "patterns",
    [
        sequence_for(SIZE),
        (*X[::2], *Y[1::2]),
        (*xor_sequence("x", 300, 4), *xor_sequence("y", 200, 4)),
        (*X, *(p for p in xor_sequence("x", 300, 4) if isinstance(p, Xor)), *xor_sequence("y", 200, 8, inverses=False)),
        (*xor_sequence("x", 300, 4, above_finest=3), *xor_sequence("y", 200, 4, inverses=False, above_finest=1)),
        (*X, *xor_sequence("x", 300, 4, above_finest=3), *Y),
        (*X, *Y, Black()),
        (*X, *Y, *X[:2], White(), White()),
        fringes([300, 30], 3),
        fringes([21, 19, 17], 4),
        (*gray_sequence("x", 300, 100), *fringes([100, 100 / 1.5], 3), *gray_sequence("y", 200, 100)),
        tuple(pattern for axis in AXES for pattern in gray_sequence(axis, 2048, 1)),
    ],
)
def test_a_determined_mix_is_accepted(patterns: tuple[Pattern, ...]) -> None:
    Decoder(patterns, SIZE)


def test_a_bit_that_never_changes_may_be_missing() -> None:
    # 11 bits count to 2047: the first is 0 on all of 720 rows, the first two of 300 columns.
    patterns = [p for axis in AXES for p in gray_sequence(axis, 2048, 1) if p.bit != 0]
    Decoder(patterns, (300, 720))
    with pytest.raises(InputError, match="no frame shows bit 0"):
        Decoder(patterns, (300, 1080))


@given(st.integers(3, 400), st.integers(1, 9))
def test_the_xor_code_counts_cells_by_stripes_of_at_most_two(length: int, cell: int) -> None:
    patterns = list(xor_sequence("x", length, cell, inverses=False))
    shown = np.array([draw(pattern, (length, 1))[0] > 0 for pattern in patterns])
    relative = np.array([isinstance(pattern, Xor) for pattern in patterns])
    gray = np.where(relative[:, None], shown ^ shown[~relative], shown)
    numbers = np.logical_xor.accumulate(gray, axis=0).T @ (1 << np.arange(len(patterns))[::-1])
    assert np.array_equal(numbers, np.arange(length) // cell)
    edges = [np.flatnonzero(np.diff(row.astype(int))) for row in shown]
    # Where a bit changes and the base does not, two stripes of it merge: at most four equal cells in a row.
    assert all(np.diff([-1, *edge, length - 1]).max() <= 4 * cell for edge in edges)


def test_patterns_equal_on_the_visible_part_are_ambiguous() -> None:
    patterns: tuple[Pattern, ...] = (
        White(),
        *gray_sequence("y", 284, 8),
        *gray_sequence("x", 427, 8),
        *phase_sequence("x", 16.0, 12),
    )
    plan = plan_sequence(patterns, (427, 284))
    number = {pattern: at for at, pattern in enumerate(patterns)}
    # Rows from 256 on are dark in it.
    assert plan.shows_the_same(number[White()], number[Gray("y", 0, 6, 8, inverted=True)])
    assert not plan.shows_the_same(number[White()], number[Gray("y", 0, 6, 8)])
    assert not plan.shows_the_same(number[Gray("x", 3, 6, 8)], number[Gray("x", 4, 6, 8)])
    assert not plan.shows_the_same(number[Phase("x", 16.0, 0.0)], number[Phase("x", 16.0, 1 / 12)])


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
