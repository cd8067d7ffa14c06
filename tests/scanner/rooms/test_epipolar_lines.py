"""Whether a capture fits the epipolar lines of a rig."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Pose
from scanner.rooms.epipolar_lines import line_offsets, of_another_rig
from tests.scanner.rooms.conftest import CAMERA
from tests.support.whole_room import TrueStation, stations, with_turned_projector


@pytest.fixture(scope="module")
def two() -> list[TrueStation]:
    return stations(2, 1, camera=CAMERA, furniture_askew_deg=4.0)


def turned(rig: Calibration, about: str, degrees: float) -> Calibration:
    turn = Rotation.from_euler(about, degrees, degrees=True).as_matrix()
    return replace(rig, pose=Pose(turn @ rig.pose.rotation, rig.pose.translation))


def test_the_true_rig_leaves_only_noise(two: list[TrueStation]) -> None:
    offsets = line_offsets(two[0].matches, two[0].calibration)
    assert 0.5 < float(np.sqrt(np.mean((offsets.median_px / offsets.error_px) ** 2))) < 1.5
    assert 0.001 < offsets.usual_px < 0.01  # of 0.03 px, in tiles of up to 256 matches
    assert offsets.deviation_px(offsets.usual_px) is None


def test_outliers_do_not_move_a_tile(two: list[TrueStation]) -> None:
    matches = two[0].matches
    wild = np.where(np.arange(len(matches)) % 10 == 0, 200.0, 0.0)[:, None]
    offsets = line_offsets(replace(matches, projector_px=matches.projector_px + wild), two[0].calibration)
    assert 0.001 < offsets.usual_px < 0.02


@pytest.mark.parametrize(("degrees", "least_px"), [(0.05, 0.2), (0.5, 2.0)])
def test_another_rig_is_reported_with_its_deviation(two: list[TrueStation], degrees: float, least_px: float) -> None:
    rig = turned(two[0].calibration, "x", degrees)
    offsets = line_offsets(two[1].matches, rig)
    usual_px = line_offsets(two[0].matches, two[0].calibration).usual_px
    deviation_px = offsets.deviation_px(usual_px)
    assert deviation_px is not None
    assert least_px < deviation_px < 5 * least_px
    assert offsets.deviation_px(2 * deviation_px) is None


def test_captures_by_another_rig_are_identified(two: list[TrueStation]) -> None:
    rig = two[0].calibration
    same = [each.matches for each in two]
    assert of_another_rig(same, rig) == {}
    assert (
        of_another_rig([same[0], replace(same[1], projector_px=same[1].projector_px + np.array([0.0, 0.05]))], rig)
        == {}
    )
    for turn_deg in ((0.3, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.3)):
        ((number, finding),) = of_another_rig([same[0], with_turned_projector(two[1], turn_deg).matches], rig).items()
        assert number == 1
        assert "projector px off the epipolar lines" in finding.message
        assert 0.03 < finding.number("off_px") < 50


def test_a_capture_without_matches_gives_no_result(two: list[TrueStation]) -> None:
    assert of_another_rig([two[0].matches, two[1].matches[:0]], two[0].calibration) == {}
