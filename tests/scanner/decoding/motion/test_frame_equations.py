"""The equations for the motion of devices in each frame, against fringes drawn with known motion and light."""

import numpy as np
import pytest

from scanner.decoding import plan_sequence
from scanner.decoding.motion import shifts_by_motion
from scanner.decoding.motion.frame_equations import (
    UNKNOWNS,
    FrameEquations,
    FringeFrames,
    FringeModel,
    equations_of_motion,
    fringe_frames,
)
from scanner.decoding.motion.fringe_motion import Trajectory, trajectories_of
from scanner.decoding.motion.fringe_pixels import MotionPixels
from scanner.decoding.motion.rigid_motion import COLUMNS
from scanner.patterns import PRESETS

SIZE, COUNT = (854, 480), 3000
FRAMES = fringe_frames(plan_sequence(PRESETS["standard"].patterns(SIZE), SIZE))
NOISE = 1.0
BUMP = Trajectory(int(FRAMES.times[8]), int(FRAMES.times[9]))


def pixels() -> MotionPixels:
    """Pixels of two slanted planes, in 300 tiles."""
    rng = np.random.default_rng(2)
    camera_px = np.stack([rng.uniform(0, 611, COUNT), rng.uniform(0, 511, COUNT)], axis=1)
    gradient = np.where((camera_px[:, 0] < 300)[:, None, None], [[1.1, 0.2], [0.05, 0.8]], [[0.7, -0.1], [-0.15, 0.9]])
    projector_px = np.einsum("pac,pc->pa", gradient, camera_px - 256) + np.array(SIZE) / 2
    by_motion = shifts_by_motion(camera_px, projector_px, gradient, (612, 512), SIZE)
    tile = np.repeat(np.arange(300), COUNT // 300)
    return MotionPixels(np.arange(COUNT), tile, camera_px, projector_px, gradient, by_motion, np.full(COUNT, NOISE))


PIXELS = pixels()


def equations(motion: np.ndarray, gains: np.ndarray | float = 1.0, late: float = 0.0) -> FrameEquations:
    """The equations of frames with a bump by `motion` (8,), `gains` (N, 1) of their light, and a share of the frame
    before in the last frame before the bump.
    """
    moved_px = BUMP.at(FRAMES.times)[:, None] * (PIXELS.by_motion @ motion).T[FRAMES.axis]
    phase = FRAMES.steepness * (PIXELS.projector_px.T[FRAMES.axis] + moved_px) + FRAMES.angles
    light = np.random.default_rng(1).uniform(60, 120, COUNT)
    levels = gains * light * (1 + 0.6 * np.cos(phase))
    levels[8] += late * (levels[7] - levels[8])
    levels += np.random.default_rng(0).normal(0, NOISE, levels.shape)
    return equations_of_motion(FringeModel(FRAMES, levels), PIXELS)


def along(found: FrameEquations, trajectory: Trajectory) -> np.ndarray:
    return np.kron(np.eye(UNKNOWNS, COLUMNS), trajectory.at(FRAMES.times)[:, None])


MOTION = np.array([0.05, -0.04, 0.02, 0.0, -0.03, 0.06, 0.0, 0.01])
GAINS = np.random.default_rng(3).uniform(0.95, 1.05, (len(FRAMES.times), 1))


@pytest.mark.parametrize("gains", [1.0, GAINS])
def test_a_bump_is_measured_beside_changes_of_light(gains: np.ndarray | float) -> None:
    found = equations(MOTION, gains)
    fit = found.along(along(found, BUMP))
    off = np.abs(fit.values - MOTION) / np.sqrt(np.diag(found.covariance(fit)))
    assert 0.3 < off.max() < 4
    moved_px, truth_px = (PIXELS.by_motion @ motion for motion in (fit.values, MOTION))
    assert np.sqrt(np.mean((moved_px - truth_px) ** 2)) < 0.1 * np.sqrt(np.mean(truth_px**2))
    assert 0.9 < found.variance(fit.of_frames) < 1.1


def test_where_frames_tell_nothing_the_sum_with_what_was_removed_is_likely_nothing() -> None:
    found = equations(MOTION)
    nowhere = np.zeros((UNKNOWNS * len(FRAMES.times), 2))
    known = np.array([0.3, -2.0])
    np.testing.assert_allclose(found.along(nowhere, known).values, -known, rtol=1e-12)
    np.testing.assert_array_equal(found.along(nowhere).values, [0.0, 0.0])


def test_the_time_of_a_bump_explains_most() -> None:
    found = equations(MOTION)
    best = max(trajectories_of(FRAMES.times), key=lambda one: found.along(along(found, one)).gained)
    assert best == BUMP


def test_nothing_is_found_at_rest() -> None:
    found = equations(np.zeros(COLUMNS))
    fits = [found.along(along(found, one)) for one in trajectories_of(FRAMES.times)]
    best = max(fits, key=lambda one: one.gained)
    assert 1 < best.gained < 50  # of some 20 trajectories, chi squared of 8 degrees of freedom
    assert 0.2 < np.max(np.abs(best.values) / np.sqrt(np.diag(found.covariance(best)))) < 5


@pytest.mark.parametrize(("motion_px", "late"), [(0.0, 0.5), (0.0, 0.1), (0.1, 0.0), (1.0, 0.0)])
def test_a_late_frame_and_a_bump_are_told_apart(motion_px: float, late: float) -> None:
    found = equations(motion_px * np.eye(COLUMNS)[0], late=late)
    by_bump = max(found.along(along(found, one)).gained for one in trajectories_of(FRAMES.times))
    by_late_frame = found.along(np.eye(UNKNOWNS * len(FRAMES.times))[:, [COLUMNS * len(FRAMES.times) + 8]])
    ratio = by_late_frame.gained / by_bump
    if late:
        assert 1.05 < ratio < 200
        assert by_late_frame.values[0] == pytest.approx(late / (1 - late), abs=0.02)  # of the frame as it is
    else:
        assert 0 < ratio < 0.95


def test_frames_are_in_the_order_of_time() -> None:
    assert isinstance(FRAMES, FringeFrames)
    assert (np.diff(FRAMES.times) > 0).all()
    assert FRAMES.successive == [(0, 1), (2, 3)]
    assert FRAMES.shortest == (1, 3)
    parameters = np.random.default_rng(5).normal(0, 1, FRAMES.design.shape[1])
    np.testing.assert_allclose(FRAMES.weights @ FRAMES.design @ parameters, parameters, atol=1e-9)
