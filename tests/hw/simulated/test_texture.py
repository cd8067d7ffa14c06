"""What is painted on surfaces has its size."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hw.simulated.texture import _FINE_M, _tape


@given(st.integers(0, 2**32 - 1), st.integers(100, 400), st.integers(50, 400))
def test_a_strip_of_tape_is_five_centimetres_wide_and_near_the_middle(seed: int, rows: int, columns: int) -> None:
    face = np.ones((rows, columns), np.float32)
    _tape(np.random.default_rng(seed), face)
    bright = np.flatnonzero(face[:, 0] > 1)
    assert 0.045 <= len(bright) * _FINE_M <= 0.055
    assert np.ptp(bright) == len(bright) - 1
    assert 0.29 * rows <= bright[0] <= 0.7 * rows
    assert (face == face[:, :1]).all()
    assert set(face.ravel()) == {1.0, 1.25}
