"""Noise of boards that the model does not fit: the estimate does not depend on the start, and matches a direct
computation.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.boards import Board, BoardView, calibrate_boards
from calib.boards.calibrate import estimated
from calib.boards.estimate import estimate
from calib.boards.likelihood import BoardVariances, Prior, device_prior
from calib.boards.parameters import State
from calib.boards.starts import rough_levels, starts
from calib.synthetic import SyntheticBoards, random_boards
from tests.support.board_captures import views_of

_FOCALS = [0, 9]
WAVE_PX = 0.1


def wavy(views: list[BoardView]) -> list[BoardView]:
    """The views with a smooth error of the matches that no parameter explains, as of a distorted print."""
    rng = np.random.default_rng(8)
    bent = []
    for view in views:
        cells = view.cells
        phase, pitch = rng.uniform(0, 2 * np.pi, 2), 2.5 * np.ptp(cells.camera_px, axis=0) / (2 * np.pi)
        wave = WAVE_PX * np.sqrt(2) * np.sin(cells.camera_px[:, ::-1] / pitch[::-1] + phase)
        bent.append(replace(view, cells=replace(cells, projector_px=cells.projector_px + wave)))
    return bent


@pytest.fixture(scope="module")
def four() -> tuple[SyntheticBoards, list[BoardView], State, Prior]:
    boards = random_boards(np.random.default_rng(2), matches=1000, views=4)
    views, rig = wavy(views_of(boards)), boards.calibration
    prior = device_prior(rig.camera.size, rig.projector.size, 7)
    start = starts(views, rig.camera.size, rig.projector.size, boards.reach, prior)[0].state
    return boards, views, start, prior


def test_the_noise_estimate_does_not_depend_on_the_start(
    four: tuple[SyntheticBoards, list[BoardView], State, Prior],
) -> None:
    _, views, start, prior = four
    rough = rough_levels(views)
    found = []
    for shares in ([1, 1, 1, 1], [1e-3, 1, 1, 1], [1, 1, 1, 1e-3]):
        levels = BoardVariances(rough.corners * shares, tuple(map(np.multiply, rough.cells, shares)))
        found.append(estimate(views, start, prior, levels))
    sigma = np.sqrt(found[0].covariance.diagonal())
    for other in found[1:]:
        assert other.levels.change(found[0].levels) < 0.1
        moved = (other.state.additive() - found[0].state.additive())[_FOCALS]
        assert np.all(np.abs(moved) < 0.1 * sigma[_FOCALS])
    assert 0.3 * WAVE_PX < np.median([noise.smooth_px for noise in found[0].noise]) < 1.5 * WAVE_PX
    weights = [float(np.median(level)) for level in found[0].levels.cells]
    assert max(weights) < 4 * min(weights)


def test_leaving_out_a_board_moves_the_estimate_as_predicted(
    four: tuple[SyntheticBoards, list[BoardView], State, Prior],
) -> None:
    boards, views, _, prior = four
    sizes = boards.calibration.camera.size, boards.calibration.projector.size
    board = Board(boards.reach, 1, "m")
    found = calibrate_boards(views, *sizes, board)
    start = starts(views[1:], *sizes, boards.reach, prior)[0].state
    without = estimated(views[1:], start, prior, board)
    moved = (without.state.additive() - found.estimate.state.additive())[_FOCALS]
    assert found.predictions[0].moved[_FOCALS] == pytest.approx(moved, abs=1e-7)  # another start, the same minimum
    assert np.abs(moved).max() > 1e-5
