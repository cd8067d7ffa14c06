"""Order statistics, against NumPy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calib.numerics import Floats, median, quantile

VALUES = arrays.arrays(np.float64, st.integers(1, 40), elements=st.floats(-1e6, 1e6))


@given(values=VALUES, share=st.floats(0, 1))
def test_quantile_equals_numpys(values: Floats, share: float) -> None:
    assert quantile(values, share) == pytest.approx(np.quantile(values, share), rel=1e-9, abs=1e-6)


@given(values=VALUES)
def test_median_equals_numpys(values: Floats) -> None:
    assert median(values) == pytest.approx(np.median(values), rel=1e-12, abs=1e-9)
