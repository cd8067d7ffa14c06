"""A known length makes metres of a calibration in units of its baseline."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Calibration, Corner, Pose
from scanner.configuration import ScaleSettings
from scanner.quantities import UNKNOWN_UNIT
from scanner.reconstruction import scaled
from tests.support.cloud_scene import CAMERA, PROJECTOR

_lengths = st.floats(0.05, 20.0)


@given(_lengths, _lengths)
def test_the_known_length_has_its_metres_afterwards(apart: float, known_m: float) -> None:
    """`apart`: of the corner, in baselines, of which there are two in the calibration's unit."""
    calibration = Calibration(CAMERA, PROJECTOR, Pose(np.eye(3), np.array([0.0, 2.0, 0.0])), UNKNOWN_UNIT)
    corner = cast(Corner, SimpleNamespace(vertex=2.0 * apart * np.array([0.6, 0.0, 0.8])))
    by_corner = scaled(calibration, corner, ScaleSettings(camera_to_corner_m=known_m, sigma_m=0.01))
    assert by_corner.baseline * apart == pytest.approx(known_m, rel=1e-9)
    by_baseline = scaled(calibration, None, ScaleSettings(baseline_m=known_m))
    assert by_baseline.baseline == pytest.approx(known_m, rel=1e-9)
    assert by_corner.unit == by_baseline.unit == "m"
    assert by_corner.sigma.known_camera_to_corner == 0.01
    assert by_baseline.sigma.known_baseline == 0.0
    assert scaled(by_corner, corner, ScaleSettings(baseline_m=1.0)) is by_corner
