"""Bits that need a parity picture."""

from itertools import combinations

import numpy as np
import pytest

from scanner.patterns import PRESETS, Gray, Xor, draw, sequence_for, unpaired_bits
from scanner.patterns.pattern import Code

SIZE = (64, 48)


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
