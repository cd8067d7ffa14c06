"""Predicted pixels of boards in front of a rig, and their derivatives."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.boards.parameters import (
    SHARED,
    PlacedBoard,
    State,
    device_of,
    predict_corners,
    predict_matches,
)
from calib.geometry import Intrinsics, Pose, rotation_about
from calib.synthetic import random_boards


def random_state(seed: int) -> State:
    rng = np.random.default_rng(seed)
    return State(
        np.array([1500, 1.01, 640, 500, -0.1, 0.05, 0.001, -0.002, 0.02]) * rng.uniform(0.9, 1.1, 9),
        np.array([1800, 0.99, 500, 700, -0.05, 0.03, -0.001, 0.002, 0.01]) * rng.uniform(0.9, 1.1, 9),
        Pose(rotation_about(rng.normal(0, 0.1, 3)), np.array([5.0, 0.3, 0.5])),
        0.01 * rng.standard_normal(7),
        4.0,
        tuple(
            PlacedBoard(
                Pose(rotation_about(rng.normal(0, 0.3, 3)), rng.normal((0, 0, 22), (0.5, 0.5, 2))),
                rng.normal(0, 1e-3, 3),
            )
            for _ in range(2)
        ),
    )


@settings(max_examples=10)
@given(st.integers(0, 10_000), st.sampled_from([0, 1]))
def test_jacobians_match_finite_differences(seed: int, view: int) -> None:
    state = random_state(seed)
    points = np.random.default_rng(seed).uniform(-4, 4, (6, 2))
    pixels = predict_corners(state, points, view)[0]
    for predict, at in ((predict_corners, points), (predict_matches, pixels)):
        jacobian = predict(state, at, view)[1]
        for local, column in enumerate(state.columns(view)):
            step = np.zeros(state.size)
            step[column] = 1e-6
            ahead, behind = (predict(state.moved(way), at, view)[0] for way in (step, -step))
            slope = (ahead - behind) / 2e-6
            assert np.abs(slope - jacobian[:, :, local]).max() < 1e-5 * (1 + np.abs(slope).max())


@pytest.mark.parametrize("seed", [0, 1])
def test_the_model_predicts_the_pixels_of_a_synthetic_board(seed: int) -> None:
    boards = random_boards(np.random.default_rng(seed), corner_px=0, match_px=0, matches=200)
    rig = boards.calibration
    bend = np.append(boards.bend, np.zeros(4))
    placed = tuple(PlacedBoard(pose) for pose in boards.poses)
    state = State(device_of(rig.camera), device_of(rig.projector), rig.pose, bend, boards.reach, placed)
    for i, view in enumerate(boards.views):
        assert np.abs(predict_corners(state, view.points, i)[0] - view.corners_px).max() < 1e-8
        assert np.abs(predict_matches(state, view.matches.camera_px, i)[0] - view.matches.projector_px).max() < 1e-6
    assert Intrinsics.of_device(state.camera, rig.camera.size) == rig.camera
    assert state.size == SHARED + 9 * len(placed)
