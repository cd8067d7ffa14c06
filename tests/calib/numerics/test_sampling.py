"""Samples are evenly spread, and of the requested number."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calib.numerics.sampling import evenly


@given(st.lists(st.booleans(), min_size=1, max_size=200), st.integers(1, 20))
def test_samples_are_evenly_spaced(flags: list[bool], size: int) -> None:
    chosen = np.array(flags)
    members = np.flatnonzero(chosen)
    sample = evenly(chosen, size)
    np.testing.assert_array_equal(sample, members[:: max(1, len(members) // size)])
    assert min(size, len(members)) <= len(sample) < 2 * size
