"""Patterns of pixels that are not square, groups that sum to uniform light, and bits that need a parity picture."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import PixelGrid
from scanner.patterns import (
    PRESETS,
    Axis,
    Black,
    Gray,
    Pattern,
    Phase,
    White,
    Xor,
    draw,
    in_square_pixels,
    level_groups,
    sequence_for,
    unpaired_bits,
)
from scanner.patterns.pattern import Code

SIZE = (64, 48)
AXES = st.sampled_from(["x", "y"])
CELLS = st.sampled_from([1, 2, 4])
GRAY = st.builds(Gray, AXES, st.integers(0, 9), st.just(10), CELLS, st.integers(0, 64), st.booleans())
XOR = st.builds(Xor, AXES, st.integers(0, 8), st.just(10), st.just(9), CELLS, st.integers(0, 64), st.booleans())
PHASE = st.builds(Phase, AXES, st.floats(8, 200), st.floats(-1, 1))
PATTERNS = st.one_of(st.just(White()), st.just(Black()), GRAY, XOR, PHASE)


@pytest.mark.parametrize("gamma", [1.0, 1.8, 2.2, 2.6])
def test_a_group_sums_to_uniform_light_for_any_gamma(gamma: float) -> None:
    patterns = sequence_for(SIZE, code="both", cell=8, inverses=True, periods=(16.0, 6.7), shifts=4)
    groups = level_groups(patterns)
    assert sorted(number for group in groups for number in group) == list(range(len(patterns)))
    for group in groups:
        light = sum((draw(patterns[k], SIZE) / 255) ** gamma for k in group)
        assert np.ptp(light) < 0.02
        assert len(group) in (2, 4)


def test_patterns_without_a_group_are_left_out() -> None:
    quick = PRESETS["quick"].patterns(SIZE)
    bits = [number for number, pattern in enumerate(quick) if isinstance(pattern, Gray)]
    groups = level_groups(quick)
    assert not any(number in group for group in groups for number in bits)
    assert [len(group) for group in groups] == [2, 4, 4]


@pytest.mark.parametrize(
    "patterns",
    [
        [],
        [White()],
        [White(), White()],
        [White(), Black(), White()],
        [Gray("x", 0, 3), Gray("x", 1, 3, inverted=True)],
        [Gray("x", 0, 3), Gray("y", 0, 3, inverted=True)],
        [Phase("x", 16, 0.0), Phase("x", 16, 0.25), Phase("x", 16, 0.5)],
        [Phase("x", 16, 0.0), Phase("x", 16, 0.5)],
        [Phase("x", 16, 0.0), Phase("x", 16, 1 / 3), Phase("x", 12, 2 / 3)],
    ],
)
def test_patterns_that_do_not_form_a_group(patterns: list[Pattern]) -> None:
    assert level_groups(patterns) == ()


def test_steps_may_come_in_any_order() -> None:
    steps = [Phase("y", 9.0, shift) for shift in (0.75, 0.0, 0.5, 0.25)]
    assert level_groups([Black(), *steps[:2], White(), *steps[2:]]) == ((0, 3), (2, 5, 4, 1))


@pytest.mark.parametrize(("code", "sizes"), [("gray", [4, 4]), ("xor", [4, 4]), ("both", [4, 3, 4, 3])])
def test_no_combination_of_a_group_is_black_or_white_everywhere(code: Code, sizes: list[int]) -> None:
    patterns = sequence_for(SIZE, code=code, cell=4, inverses=False)
    groups = unpaired_bits(patterns)
    assert [len(group) for group in groups] == sizes
    assert sorted(number for group in groups for number in group) == [
        number for number, pattern in enumerate(patterns) if isinstance(pattern, Gray | Xor)
    ]
    for group in groups:
        lit = [draw(patterns[number], SIZE) > 0 for number in group]
        for count in range(1, len(group) + 1):
            for chosen in combinations(lit, count):
                assert 0 < np.mean(np.logical_xor.reduce(chosen)) < 1


def test_bits_with_inverses_and_repeated_bits_are_left_out() -> None:
    assert unpaired_bits(PRESETS["standard"].patterns(SIZE)) == ()
    first, second, third = (Gray("x", bit, 3) for bit in range(3))
    assert unpaired_bits([first, second, third, second]) == ((0, 2),)
    assert unpaired_bits([first, second, Gray("x", 1, 3, inverted=True)]) == ()


@given(pattern=PATTERNS, aspect=st.sampled_from([0.25, 0.5, 1.0, 2.0]))
def test_each_pixel_shows_the_same_in_as_many_square_ones(pattern: Pattern, aspect: float) -> None:
    size = (96, 64)
    (stretched,), (width, height) = in_square_pixels([pattern], size, PixelGrid(aspect))
    across, down = round(max(1, 1 / aspect)), round(max(1, aspect))
    assert (width, height) == (across * size[0], down * size[1])
    # Where their centre is, in square pixels.
    x, y = np.meshgrid(np.arange(float(size[0])), np.arange(float(size[1])))
    middle_x, middle_y = (x + 0.5) * float(across) - 0.5, (y + 0.5) * float(down) - 0.5
    if isinstance(pattern, Phase):
        assert np.allclose(stretched.brightness(middle_x, middle_y), pattern.brightness(x, y), atol=1e-6)
        return
    for dx in range(across):
        for dy in range(down):
            assert np.array_equal(stretched.brightness(x * across + dx, y * down + dy), pattern.brightness(x, y))


@pytest.mark.parametrize("axis", ["x", "y"])
def test_square_pixels_stay(axis: Axis) -> None:
    patterns: list[Pattern] = [Gray(axis, 3, 8, 2, 16), Phase(axis, 20.0, 0.25)]
    assert in_square_pixels(patterns, (192, 108), PixelGrid()) == (tuple(patterns), (192, 108))
