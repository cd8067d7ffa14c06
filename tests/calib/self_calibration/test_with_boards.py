"""Boards and a corner of one rig: a joint estimate, and a rig that changed in between."""

from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import Calibration
from calib.refinement import SHARED, KnownRig
from calib.refusal import RefusalError
from calib.self_calibration import self_calibrate_jointly
from calib.synthetic import BoardOptions
from tests.support.known_rigs import Before, before, corner_before, errors_of, intrinsics_and_length, sigmas

pytestmark = pytest.mark.xdist_group("boards and corner")  # what they share is made once


@pytest.fixture(scope="module")
def some() -> list[Before]:
    return [before(seed) for seed in (0, 1)]


def metric(case: Before) -> Calibration:
    return case.joint().metric


def test_errors_match_their_sigmas(some: list[Before]) -> None:
    errors = []
    for case in some:
        joint = metric(case)
        assert joint.unit == "m"
        errors.append((intrinsics_and_length(joint) - intrinsics_and_length(case.truth)) / sigmas(joint))
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_the_joint_sigmas_are_smaller_than_either_alone(some: list[Before]) -> None:
    shares = []
    for case in some:
        joint, by_boards = sigmas(metric(case)), sigmas(case.boards.calibration)
        sizes = case.truth.camera.size, case.truth.projector.size
        (alone,) = self_calibrate_jointly([case.corner], *sizes, principal_point=case.guess)
        own = alone.calibration.sigma
        assert np.all(joint < 1.02 * by_boards)
        assert joint[0] < own.camera.focal_px[0]
        assert joint[3] < own.projector.focal_px[0]
        shares.append(joint / by_boards)
    assert 0.3 < np.min(shares) < 0.97


def test_a_zoom_between_boards_and_corner_is_named(some: list[Before]) -> None:
    zoomed = corner_before(np.random.default_rng(1), some[1].truth, 1.02)
    with pytest.raises(RefusalError, match="rig changed between") as refused:
        replace(some[1], corner=zoomed).joint()
    assert "they differ in the " in refused.value.reason
    assert "the projector's " in refused.value.reason


def test_board_lens_estimates_are_used_as_priors_of_the_corner() -> None:
    options = BoardOptions()
    camera = replace(options.camera, distortion=(-0.08, 0.05, 0.004, -0.003, 0.0))
    case = before(3, camera=camera)
    assert any(case.boards.calibration.camera.distortion[2:4])
    found = case.joint()
    sigma = case.boards.calibration.sigma.camera.distortion
    assert sigma is not None
    moved = np.subtract(found.calibration.camera.distortion, case.boards.calibration.camera.distortion)
    assert np.all(np.abs(moved) < 3 * np.array(sigma))
    assert 0.05 < found.residual_px < 0.2  # noise of 0.1 px; without those terms some pixels
    joint = found.metric
    errors = (intrinsics_and_length(joint) - intrinsics_and_length(case.truth)) / sigmas(joint)
    assert np.sqrt(np.mean(errors**2)) < 2.5


def test_the_gradient_of_the_prior_matches_its_cost(some: list[Before]) -> None:
    rig, rng = some[0].known.rig, np.random.default_rng(0)
    scale = np.sqrt(rig.safe_covariance.diagonal())
    state = rig.state.moved(30 * scale * rng.normal(size=SHARED))
    cost, slope, curvature = rig.misfit(state)
    assert cost > 100
    for column in range(SHARED):
        step = np.zeros(SHARED)
        step[column] = 1e-3 * scale[column]
        ahead, behind = (rig.misfit(state.moved(sign * step))[0] for sign in (1, -1))
        assert np.isclose((ahead - behind) / 2e-3, 2 * slope[column] * scale[column], rtol=1e-4, atol=1e-3 * cost)
    assert np.allclose(curvature, curvature.T, rtol=1e-6)
    assert KnownRig(rig.state, rig.covariance).misfit(rig.state)[0] == pytest.approx(0, abs=1e-9)


def test_the_covariance_of_the_baseline_includes_its_own_sigma(some: list[Before]) -> None:
    known = some[0].known
    sigma = known.calibration.sigma.known_baseline / known.calibration.baseline
    causes = errors_of(known).log_scale
    assert np.linalg.norm(causes) == pytest.approx(sigma, rel=1e-6)
    assert 0.05 * sigma < causes[-1] < 0.999 * sigma
