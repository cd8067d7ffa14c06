"""Whether rays meet under a rig: a true one is within chance, and each change is named with its amount."""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnostics import explain_change
from calib.geometry import Matches, Pose, rotation_about
from calib.geometry import radial_distortion as lens
from calib.refinement import State
from calib.scene.epipolar_lines import in_square_pixels, rig_by_lines
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
    """How much less likely than chance the rig is, and what has changed."""
    lines = rig_by_lines(rig, matches)
    assert 0.7 * _NOISE_PX < lines.best_px < 1.4 * _NOISE_PX
    change = explain_change(lines.step, lines.information)
    return change.times, str(change)


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


def test_a_rig_far_off_is_not_left_for_a_worse_one() -> None:
    rig, matches = seen(3)
    near = matches[np.flatnonzero(np.abs(matches.camera_px - matches.camera_px[0]).max(axis=1) < 150)]
    turn = rotation_about(np.radians([0.0, 2.0, 1.0]))
    lines = rig_by_lines(replace(rig, pose=Pose(turn @ rig.pose.rotation, rig.pose.translation)), near)
    assert lines.given_px > 1
    assert 0.01 < lines.best_px < lines.given_px / 3


def test_stretched_pixels_change_no_ray() -> None:
    rng = np.random.default_rng(4)
    (capture,) = random_captures(rng, 1, count=200, noise_px=_NOISE_PX)
    truth = capture.calibration
    (fx, fy), centre = truth.projector.focal_px, np.array(truth.projector.principal_point_px)
    uneven = replace(truth, projector=replace(truth.projector, focal_px=(fx, 1.05 * fy)))
    seen_by_uneven = centre + (capture.matches.projector_px - centre) * [1.0, 1.05]
    rig, matches = in_square_pixels(uneven, replace(capture.matches, projector_px=seen_by_uneven))
    square = true_rig(truth)
    assert np.allclose(rig.camera, square.camera)
    assert rig.projector[0] == pytest.approx(1.025 * fx)
    rays, true_rays = (
        lens.unproject(device, pixels)[0]
        for device, pixels in (
            (rig.projector, matches.projector_px),
            (square.projector, capture.matches.projector_px),
        )
    )
    assert np.allclose(rays, true_rays, atol=1e-9)
