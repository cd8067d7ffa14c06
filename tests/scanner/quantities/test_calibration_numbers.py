"""Numbers for reading."""

import math

from hypothesis import given
from hypothesis import strategies as st

from scanner.quantities.calibration_numbers import plain


@given(st.floats(-1e6, 1e6), st.integers(0, 6))
def test_a_number_has_its_sign_unless_zero_is_shown(value: float, decimals: int) -> None:
    shown = plain(value, decimals, signed=True)
    assert math.isclose(float(shown.replace("−", "-")), value, abs_tol=0.501 * 10**-decimals)
    assert shown[0] in ("+" if value > 0 else "−") or float(shown) == 0
    assert not shown.startswith(("+0.00", "−0.00")) or any(digit in shown for digit in "123456789")
    assert plain(value, decimals) == shown.removeprefix("+")


def test_what_rounds_to_zero_is_zero() -> None:
    assert [plain(value, 2, signed=True) for value in (-0.0034, 0.0034, 0.0, -0.006)] == [
        "0.00",
        "0.00",
        "0.00",
        "−0.01",
    ]
