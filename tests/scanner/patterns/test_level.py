"""Groups of patterns that sum to uniform light."""

import numpy as np
import pytest

from scanner.patterns import PRESETS, Black, Gray, Pattern, Phase, White, draw, level_groups, sequence_for

SIZE = (64, 48)


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
