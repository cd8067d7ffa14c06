"""Responses of a fringe to motion, and its frames without a known motion."""

import numpy as np
import pytest

from scanner.decoding import Fringe
from scanner.decoding.motion.frame_equations import FringeFrames, FringeModel

PERIOD, SHIFTS = 8.0, np.arange(6) / 6
FRINGE = Fringe("x", PERIOD, tuple(SHIFTS.tolist()), tuple(range(6)))
FRAMES = FringeFrames((FRINGE,), np.arange(6), np.zeros(6, np.int64), 2 * np.pi * SHIFTS[:, None])
# The completed share of the motion in each frame.
TRAJECTORY = np.array([0.0, 0.0, 0.0, 0.4, 1.0, 1.0])


def fringe(motion_px: float) -> FringeModel:
    """A fringe in 500 pixels that move by `motion_px`."""
    rng = np.random.default_rng(4)
    position, amplitude = rng.uniform(0, PERIOD, 500), rng.uniform(20, 90, 500)
    angle = 2 * np.pi * ((position + motion_px * TRAJECTORY[:, None]) / PERIOD + SHIFTS[:, None])
    return FringeModel(FRAMES, 100 + amplitude * np.cos(angle))


def phases(model: FringeModel) -> np.ndarray:
    return model.waves[0][0]


def test_a_fringe_responds_to_a_motion_by_its_slope_and_its_position() -> None:
    rest, moved = fringe(0.0), fringe(1e-3)
    np.testing.assert_allclose(
        moved.levels - rest.levels,
        1e-3 * TRAJECTORY[:, None] * rest.slopes,
        atol=2e-3 * np.abs(rest.slopes).max() * 1e-3,
    )
    shifted_px = np.angle(np.exp(1j * (phases(moved) - phases(rest)))) * PERIOD / (2 * np.pi)
    response = TRAJECTORY @ rest.responses
    assert np.median(np.abs(response - shifted_px / 1e-3)) < 2e-3
    assert 0.2 < np.median(response) < 0.8


@pytest.mark.parametrize("motion_px", [0.5, -1.3])
def test_a_known_motion_is_removed_from_the_frames(motion_px: float) -> None:
    rest, moved = fringe(0.0), fringe(motion_px)
    without = moved.without(np.repeat(motion_px * TRAJECTORY[:, None], 500, axis=1))
    assert np.abs(moved.residuals).max() > 5
    np.testing.assert_allclose(without.levels, rest.levels, atol=1e-9)
