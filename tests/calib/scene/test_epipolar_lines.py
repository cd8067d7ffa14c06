"""Whether rays meet under a rig: a true one is within chance, and each change is named with its amount."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnostics import explain_change
from calib.geometry import Matches, Pose, rotation_about
from calib.refinement import State
from calib.scene.epipolar_lines import rig_by_lines
from calib.synthetic import random_captures
from tests.support.things import true_rig

_NOISE_PX = 0.05


def seen(seed: int) -> tuple[State, Matches]:
    """A rig with square pixels, and matches of a corner with known noise."""
    rng = np.random.default_rng(seed)
    (capture,) = random_captures(rng, 1, count=4000, noise_px=_NOISE_PX)
    matches = capture.matches
    return true_rig(capture.calibration), replace(matches, sigma_px=np.full(len(matches), _NOISE_PX))


def judged(rig: State, matches: Matches) -> tuple[float, str]:
    lines = rig_by_lines(rig, matches)
    assert 0.7 * _NOISE_PX < lines.best_px < 1.4 * _NOISE_PX
    return explain_change(lines.step, lines.information)


@pytest.mark.parametrize("seed", range(5))
def test_a_true_rig_is_within_chance(seed: int) -> None:
    times, _ = judged(*seen(seed))
    assert 0.01 < times < 1


@pytest.mark.parametrize("degrees", [0.05, 0.2])
def test_a_turn_is_named_with_its_amount(degrees: float) -> None:
    rig, matches = seen(1)
    turn = rotation_about(np.radians([degrees, 0.0, 0.0]))
    times, change = judged(replace(rig, pose=Pose(turn @ rig.pose.rotation, rig.pose.translation)), matches)
    assert times > 5
    assert change.startswith(f"A change of the rotation between them by {degrees}°")


def test_a_shifted_lens_is_named() -> None:
    rig, matches = seen(2)
    projector = rig.projector.copy()
    projector[2] += 4.0
    times, change = judged(replace(rig, projector=projector), matches)
    assert times > 5
    assert "the projector's principal point by 4 px" in change or "by 3.9 px" in change or "by 4.1 px" in change
