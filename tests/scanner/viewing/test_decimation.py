"""Clouds shown with fewer points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.viewing.decimation import many, shuffled, statement


@given(st.integers(0, 5000))
def test_the_order_is_a_fixed_permutation(count: int) -> None:
    order = shuffled(count)
    assert np.array_equal(np.sort(order), np.arange(count))
    assert np.array_equal(order, shuffled(count))


def test_every_prefix_is_evenly_spread() -> None:
    first = shuffled(1_000_000)[:10_000]
    per_tenth = np.bincount(first // 100_000, minlength=10)
    assert per_tenth.min() > 850
    assert per_tenth.max() < 1150


@pytest.mark.parametrize(
    ("shown", "total", "text"),
    [
        (612_500, 4_900_000, "showing 1 in 8 of 4.9 million points"),
        (500_000, 4_900_000, "showing 1 in 10 of 4.9 million points"),
        (500_000, 1_250_000, "showing 1 in 2.5 of 1.2 million points"),
        (13_024, 13_024, "showing all 13,024 points"),
        (0, 7, "showing none of 7 points"),
    ],
)
def test_the_decimation_is_stated(shown: int, total: int, text: str) -> None:
    assert statement(shown, total) == text


def test_more_points_than_all_is_an_error() -> None:
    with pytest.raises(ValueError, match="0 to 5"):
        statement(6, 5)


def test_large_numbers_are_formatted() -> None:
    assert (many(999_999), many(4_912_345)) == ("999,999", "4.9 million")
