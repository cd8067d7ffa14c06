"""Calibration from boards with ground truth: errors match sigmas, and refusals give reasons."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.boards import Board, BoardCalibration, BoardView, best_next_pose, calibrate_boards
from calib.geometry import Calibration
from calib.refusal import RefusalError
from calib.synthetic import SyntheticBoards, random_boards
from tests.support.board_captures import views_of

pytestmark = pytest.mark.xdist_group("board calibration")  # what the module shares is made once


def made_up(seed: int, **changes: Any) -> SyntheticBoards:
    return random_boards(np.random.default_rng(seed), matches=3000, **changes)


def calibrated(boards: SyntheticBoards, views: list[BoardView] | None = None, turns: int = 1) -> BoardCalibration:
    rig = boards.calibration
    board = Board(boards.reach, turns, "m")
    return calibrate_boards(views_of(boards) if views is None else views, rig.camera.size, rig.projector.size, board)


def in_sigmas(found: BoardCalibration, truth: Calibration) -> np.ndarray:
    calibration, sigma = found.calibration, found.calibration.sigma
    errors = []
    for device, true, own in (
        (calibration.camera, truth.camera, sigma.camera),
        (calibration.projector, truth.projector, sigma.projector),
    ):
        errors.append((device.focal_px[0] - true.focal_px[0]) / own.focal_px[0])
        errors += list(np.subtract(device.principal_point_px, true.principal_point_px) / own.principal_point_px)
    return np.array([*errors, (calibration.baseline - truth.baseline) / sigma.known_baseline])


@pytest.fixture(scope="module")
def six() -> tuple[SyntheticBoards, BoardCalibration]:
    boards = made_up(5)
    return boards, calibrated(boards)


def test_errors_match_their_sigmas(six: tuple[SyntheticBoards, BoardCalibration]) -> None:
    errors = []
    four = [made_up(seed, views=4) for seed in (0, 1)]
    for boards, found in (six, *zip(four, map(calibrated, four), strict=True)):
        errors.append(in_sigmas(found, boards.calibration))
        assert found.calibration.sigma.camera.focal_px[0] < 0.002 * found.calibration.camera.focal_px[0]
    assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 2.0


def test_cross_validation_errors_match_the_prediction(six: tuple[SyntheticBoards, BoardCalibration]) -> None:
    _, found = six
    assert len(found.predictions) == 6
    assert 0.4 < np.sqrt(np.mean([prediction.sigmas**2 for prediction in found.predictions])) < 1.9
    assert 0.1 < found.halves.sigmas < 3.0
    assert set(found.halves.first) | set(found.halves.second) == {f"view {i}" for i in range(6)}


def test_the_bend_of_the_board_is_estimated(six: tuple[SyntheticBoards, BoardCalibration]) -> None:
    boards, found = six
    sigma = np.sqrt(found.estimate.covariance.diagonal())[24:27]
    assert np.all(np.abs(found.estimate.state.bend[:3] - boards.bend) < 4 * sigma)
    assert np.all(sigma < 3e-4)


def test_a_further_board_reduces_sigmas_as_predicted(six: tuple[SyntheticBoards, BoardCalibration]) -> None:
    boards, found = six
    rig = boards.calibration
    pose = best_next_pose(found.estimate, (rig.camera.size, rig.projector.size))
    assert 1.0 < pose.gain < 3.0
    assert "projected picture" in pose.words


def test_boards_symmetric_under_half_a_turn_are_oriented_consistently() -> None:
    boards = made_up(7, views=4, bend=0.004)
    views = views_of(boards)
    # Cubic terms tell one end from the other; without any, either way round is right.
    views[2] = replace(views[2], points=-views[2].points)
    found = calibrated(boards, views, turns=2)
    assert np.abs(in_sigmas(found, boards.calibration)).max() < 5


def test_a_board_that_moved_is_named_and_left_out() -> None:
    boards = made_up(3, views=5)
    views = views_of(boards)
    moved = replace(views[4].cells, projector_px=views[4].cells.projector_px + np.array([3.0, 0.0]))
    views[4] = replace(views[4], cells=moved)
    found = calibrated(boards, views)
    assert [odd.name for odd in found.left_out] == ["view 4"]
    assert any("view 4 was left out" in finding.message for finding in found.findings)
    assert np.abs(in_sigmas(found, boards.calibration)).max() < 5


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"views": 3, "tilt_deg": (0.0, 1.5), "distance": (0.99, 1.01)}, "parallel"),
        ({"views": 3, "square": 0.007, "aside": 0.02}, "cover only"),
        ({"views": 2}, "at least three are needed"),
    ],
)
def test_boards_that_do_not_determine_a_rig_are_refused_with_a_reason(changes: dict[str, Any], reason: str) -> None:
    boards = made_up(4, **changes)
    with pytest.raises(RefusalError, match=reason):
        calibrated(boards)
