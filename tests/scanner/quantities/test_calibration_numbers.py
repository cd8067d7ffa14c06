"""Formatted numbers."""

import io
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Corner, DeviceSigmas, Intrinsics, Pose, Sigmas
from scanner.configuration import ScaleSettings
from scanner.errors import InputError
from scanner.quantities.calibration_numbers import (
    calibration_table,
    device_quantities,
    intrinsic_errors_percent,
    plain,
    truth_line,
)
from scanner.reconstruction import scaled
from scanner.ui import Terminal

TRUTH = Calibration(
    Intrinsics(1224, 1024, (895.0, 895.0), (628.0, 527.0)),
    Intrinsics(854, 480, (1250.0, 1250.0), (400.0, 200.0)),
    Pose(np.eye(3), np.array([-0.4, 0, 0])),
    "m",
)
FOUND = replace(
    TRUTH,
    camera=replace(TRUTH.camera, focal_px=(903.95, 903.95)),
    projector=replace(TRUTH.projector, focal_px=(1225.0, 1225.0), principal_point_px=(404.0, 199.0)),
    pose=Pose(Rotation.from_rotvec([0, 0, np.radians(0.5)]).as_matrix(), np.array([-np.cos(0.01), np.sin(0.01), 0])),
    unit="baseline",
    sigma=Sigmas(
        DeviceSigmas(focal_px=(9.5, 9.5), distortion=(0.011, 0.02)), DeviceSigmas(principal_point_px=(3.25, 1.75))
    ),
)


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


def printed(*args: Calibration) -> str:
    out = io.StringIO()
    Console(file=out, width=120).print(calibration_table(*args))
    return out.getvalue()


def test_errors_are_relative_to_the_truth() -> None:
    np.testing.assert_allclose(intrinsic_errors_percent(FOUND, TRUTH), [1.0, -2.0, 1.0, -0.5], atol=0.01)


def test_the_summary_line_of_the_truth() -> None:
    line = truth_line(FOUND, TRUTH)
    for words in ("1.13 %", "rotation 0.500°", "baseline 0.573°"):
        assert words in line


def test_the_table_shows_values_and_sigmas() -> None:
    text = printed(FOUND)
    for words in ("904.0", "± 9.5", "1225.0", "404.0", "± 3.2", "199.0", "± 1.8", "baseline"):
        assert words in text
    assert "truth" not in text


def test_the_table_shows_the_truth_beside_it() -> None:
    text = printed(FOUND, TRUTH)
    for words in ("truth", "895.0", "+9.0", "+1.00", "1250.0", "−25.0", "−2.00", "+4.0"):
        assert words in text


def test_a_baseline_is_compared_in_the_same_unit_only() -> None:
    assert "0.4000" not in printed(FOUND, TRUTH)
    assert "+0.1000" in printed(FOUND.scaled(0.5, "m"), TRUTH)


CORNER = Corner(np.array([0.0, 3.0, 4.0]), np.eye(3))


@pytest.mark.parametrize(
    ("scale", "baseline", "unit"),
    [
        (None, 1.0, "baseline"),
        (ScaleSettings(), 1.0, "baseline"),
        (ScaleSettings(baseline_m=0.4), 0.4, "m"),
        (ScaleSettings(camera_to_corner_m=2.5), 0.5, "m"),
    ],
)
def test_one_length_fixes_the_scale(scale: ScaleSettings | None, baseline: float, unit: str) -> None:
    calibration = scaled(FOUND, CORNER, scale)
    assert calibration.baseline == pytest.approx(baseline)
    assert calibration.unit == unit
    np.testing.assert_allclose(calibration.pose.translation / baseline, FOUND.pose.translation)


def test_a_calibration_with_a_unit_keeps_it() -> None:
    assert scaled(TRUTH, None, ScaleSettings(baseline_m=7)) is TRUTH


def test_a_distance_to_the_corner_needs_a_corner() -> None:
    with pytest.raises(InputError, match="camera_to_corner_m"):
        scaled(FOUND, None, ScaleSettings(camera_to_corner_m=2.5))


def test_a_quiet_terminal_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal(quiet=True)
    assert list(terminal.track(range(3), 3, "Counting")) == [0, 1, 2]
    with terminal.step("Thinking"):
        terminal.show("done")
    assert capsys.readouterr() == ("", "")


def test_piped_output_is_the_summary_only(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal()
    assert list(terminal.track(range(3), 3, "Counting")) == [0, 1, 2]
    with terminal.step("Thinking"):
        terminal.show("done")
    assert capsys.readouterr() == ("done\n", "")
