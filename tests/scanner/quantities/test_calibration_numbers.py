"""Formatted numbers."""

import math

from hypothesis import given
from hypothesis import strategies as st

from scanner.quantities.calibration_numbers import plain


@given(st.floats(-1e6, 1e6), st.integers(0, 6))
def test_numbers_have_a_sign_unless_shown_as_zero(value: float, decimals: int) -> None:
    shown = plain(value, decimals, signed=True)
    assert math.isclose(float(shown.replace("−", "-")), value, abs_tol=0.501 * 10**-decimals)
    assert shown[0] in ("+" if value > 0 else "−") or float(shown) == 0
    assert not shown.startswith(("+0.00", "−0.00")) or any(digit in shown for digit in "123456789")
    assert plain(value, decimals) == shown.removeprefix("+")


def test_values_that_round_to_zero_have_no_sign() -> None:
    assert [plain(value, 2, signed=True) for value in (-0.0034, 0.0034, 0.0, -0.006)] == [
        "0.00",
        "0.00",
        "0.00",
        "−0.01",
    ]
