"""Samples are evenly spread, and of the requested number."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calib.numerics.sampling import evenly


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
