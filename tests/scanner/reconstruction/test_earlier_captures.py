"""A corrected motion: its residual effect is refused or reported, depending on its cost."""

from dataclasses import replace

import numpy as np
import pytest

from calib.refusal import RefusalError
from calib.self_calibration import SelfCalibration
from scanner.decoding.motion import CoordinateShift, MotionCourse, MotionEstimate, MotionVerdict
from scanner.reconstruction.earlier_captures import refuse_costly, with_motion_findings
from scanner.results import Decoded, Reconstructed, SelfCalibrated
from tests.support.cloud_scene import room
from tests.support.result_folder import SIZES, calibrated_report

SHIFT = CoordinateShift(np.zeros((2, 8)), *((size.width, size.height) for size in SIZES))
PROJECTOR = np.array([0.3, 0, 0, 0, 0, 0, 0, 0])
MOTION = MotionEstimate(
    16, 21, 0.3, PROJECTOR, MotionCourse.BUMP, MotionVerdict.CORRECTABLE, explained=0.9, shift=SHIFT, alternatives=()
)


@pytest.fixture(scope="module")
def capture() -> tuple[Decoded, SelfCalibration]:
    outcome = calibrated_report(room()).outcome
    assert isinstance(outcome, Reconstructed)
    calibrated = outcome.calibrated
    assert isinstance(calibrated, SelfCalibrated)
    decoding = calibrated.decoded.decoding
    assert decoding is not None
    return replace(calibrated.decoded, origin=replace(decoding, motion=MOTION)), calibrated.solution


@pytest.mark.parametrize(
    ("at_rest", "likely", "refused"),
    [(0.1, 0.4, False), (0.1, 0.6, True), (1.2, 0.9, False), (1.2, 1.3, True)],
)
def test_motion_is_accepted_up_to_the_uncertainty_at_rest(
    capture: tuple[Decoded, SelfCalibration], at_rest: float, likely: float, refused: bool
) -> None:
    decoded, solution = capture
    solution = replace(solution, at_rest_percent=at_rest, likely_percent=likely)
    if refused:
        with pytest.raises(RefusalError, match=r"The projector moved by 0.3 px between frames 16 and 21"):
            refuse_costly([decoded], solution)
        return
    refuse_costly([decoded], solution)
    added = with_motion_findings([decoded], solution).findings[len(solution.findings) :]
    assert len(added) == (likely > 0.5)
    for finding in added:
        assert finding.data == {"intrinsics_percent": 0.9, "at_rest_percent": 1.2}
        assert "may change the intrinsics by 0.9 %; at rest, this view determines them to 1.2 %" in finding.message
