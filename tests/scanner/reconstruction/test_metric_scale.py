"""A known length makes metres of a calibration in units of its baseline.

A ChArUco board on the floor of a simulated room determines the scale, with a true sigma.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Calibration, Corner, Matches, Pose, Size
from calib.refusal import RefusalError
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedCamera, SimulatedProjector, SimulatedRoom
from scanner.capture import CaptureMetadata
from scanner.configuration import CharucoSettings, ScaleSettings
from scanner.errors import InputError
from scanner.quantities import UNKNOWN_UNIT
from scanner.reconstruction import scaled
from scanner.reconstruction.metric_scale import scaled_by_sheet
from scanner.results import Decoded, GivenMatches
from tests.support.cloud_scene import CAMERA, PROJECTOR

_lengths = st.floats(0.05, 20.0)
pytestmark = pytest.mark.xdist_group("sheet scale")  # what the module shares is made once

SQUARE_MM = 100.0
CAMERA_OF_SHEET, PROJECTOR_OF_SHEET = (918, 768), (427, 240)
NOISE_PX = 0.05


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


@pytest.fixture(scope="module")
def room() -> SimulatedRoom:
    board = {"kind": "charuco", "columns": 5, "rows": 4, "square_m": SQUARE_MM / 1000, "on_floor": True}
    settings = SimulatedRigSettings.model_validate(
        {"seed": 2, "furniture": False, "interreflection": False, "board": board}
    )
    return SimulatedRoom(settings, CAMERA_OF_SHEET, PROJECTOR_OF_SHEET)


@pytest.fixture(scope="module")
def rig(room: SimulatedRoom) -> Calibration:
    """A rig in units of the baseline."""
    return room.calibration.in_baselines


@pytest.fixture(scope="module")
def capture(room: SimulatedRoom) -> Decoded:
    projector = SimulatedProjector(room)
    projector.show(np.full(PROJECTOR_OF_SHEET[::-1], 255, np.uint8))
    picture = SimulatedCamera(room, projector).grab().image
    projected = room.ground_truth().projector_px
    row, column = np.nonzero(np.isfinite(projected).all(axis=2))
    noise = np.random.default_rng(0).normal(0, NOISE_PX, (len(row), 2))
    matches = Matches(np.stack([column, row], axis=1).astype(np.float64), projected[row, column] + noise)
    metadata = CaptureMetadata(Size(*CAMERA_OF_SHEET), Size(*PROJECTOR_OF_SHEET))
    return Decoded(metadata, matches, GivenMatches(picture), "the room")


def test_the_baseline_is_found(room: SimulatedRoom, rig: Calibration, capture: Decoded) -> None:
    truth = room.calibration.baseline
    exact, _ = scaled_by_sheet(rig, None, [capture], CharucoSettings(board="5x4", square_mm=SQUARE_MM))
    assert exact.unit == "m"
    assert 1e-5 * truth < exact.sigma.known_baseline < 2e-3 * truth
    assert abs(exact.baseline - truth) < 3.5 * exact.sigma.known_baseline
    # The sheet's own sigma is part of it, and captures without the sheet do no harm.
    settings = CharucoSettings(board="5x4", square_mm=SQUARE_MM, sigma_mm=1.0)
    blank = replace(capture, origin=GivenMatches(None), name="another")
    unsure, _ = scaled_by_sheet(rig, None, [blank, capture], settings)
    assert unsure.baseline == pytest.approx(exact.baseline)
    assert 0.0099 < unsure.sigma.known_baseline / unsure.baseline < 0.0115


def test_without_a_board_there_is_no_scale(rig: Calibration, capture: Decoded) -> None:
    with pytest.raises(RefusalError, match="no charuco:7x9 was found") as refused:
        scaled_by_sheet(rig, None, [capture], CharucoSettings(board="7x9", square_mm=30))
    assert "scan calibrate" in refused.value.advice
    unlit = replace(capture, matches=capture.matches[:100])
    for other, told in ((replace(capture, origin=GivenMatches(None)), "no picture"), (unlit, "matches only")):
        with pytest.raises(RefusalError, match=told):
            scaled_by_sheet(rig, None, [other], CharucoSettings(board="5x4", square_mm=SQUARE_MM))
    with pytest.raises(InputError, match="projector lights"):
        scaled(rig, None, ScaleSettings(charuco=CharucoSettings(square_mm=30)))
