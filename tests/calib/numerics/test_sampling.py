"""Samples are evenly spread or random, and of the requested number; what is distinct is so by definition."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calib.numerics import at_random, distinct, evenly, evenly_spread


@given(st.lists(st.booleans(), min_size=1, max_size=200), st.integers(1, 20))
def test_one_of_every_few_is_drawn(flags: list[bool], size: int) -> None:
    chosen = np.array(flags)
    members = np.flatnonzero(chosen)
    sample = evenly(chosen, size)
    step = max(1, len(members) // size)
    np.testing.assert_array_equal(np.searchsorted(members, sample) // step, np.arange(len(sample)))
    assert np.isin(sample, members).all()
    assert min(size, len(members)) <= len(sample) < 2 * size


def test_samples_of_an_image_are_in_all_its_columns() -> None:
    columns = evenly(np.ones(128 * 1000, np.bool_), 1000) % 128
    counts = np.bincount(columns, minlength=128)
    assert 5 <= counts.min() <= counts.max() <= 10


@given(st.integers(1, 3000), st.integers(1, 500))
def test_every_kth_is_drawn(count: int, most: int) -> None:
    drawn = evenly_spread(np.arange(count), most)
    assert len(set(np.diff(drawn))) <= 1
    assert drawn[0] == 0
    assert min(count, most / 2) <= len(drawn) <= most
    assert evenly_spread(np.zeros((3, count)), most, axis=-1).shape == (3, len(drawn))


@given(st.integers(1, 3000), st.integers(1, 500))
def test_random_draws_are_ascending_and_the_same_in_every_run(count: int, most: int) -> None:
    drawn = at_random(count, most)
    assert len(drawn) == min(count, most)
    assert (np.diff(drawn) > 0).all()
    assert 0 <= drawn[0] <= drawn[-1] < count
    np.testing.assert_array_equal(drawn, at_random(count, most))


@given(st.lists(st.integers(0, 50), max_size=40), st.integers(0, 8), st.integers(1, 40))
def test_what_is_distinct_is_unlike_all_that_is_better(places: list[int], apart: int, most: int) -> None:
    """As by one comparison after the other."""
    values = np.array(places, np.int64)
    chosen = distinct(len(values), lambda k: np.abs(values - values[k]) <= apart, most)
    expected: list[int] = []
    for number, place in enumerate(places):
        if len(expected) < most and all(abs(place - places[better]) > apart for better in expected):
            expected.append(number)
    assert chosen == expected
    assert distinct(len(values), lambda k: np.abs(values - values[k]) <= apart)[: len(chosen)] == chosen
