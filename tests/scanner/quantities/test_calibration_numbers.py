"""Formatted numbers."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Calibration, Intrinsics, Pose
from scanner.quantities.calibration_numbers import device_quantities, plain


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


def test_quantities_of_a_device_say_what_they_mean() -> None:
    rig = Calibration(
        Intrinsics(1224, 1024, (895.0, 895.0), (628.0, 527.0)),
        Intrinsics(854, 480, (1250.0, 1250.0), (400.0, 200.0)),
        Pose(np.eye(3), np.array([-0.4, 0.0, 0.0])),
        "m",
    )
    camera, projector = (
        {quantity.name: quantity.meaning for quantity in device_quantities(name, rig, None)}
        for name in ("camera", "projector")
    )
    assert camera == {
        "focal length": "field of view 69°",  # 2 atan(612 / 895)
        "principal point x₀": "image centre 611.5",
        "principal point y₀": "image centre 511.5",
    }
    assert projector == {
        "focal length": "field of view 38°, throw ratio 1.46",  # 1250 / 854
        "principal point x₀": "image centre 426.5",
        "principal point y₀": "image centre 239.5",
    }
