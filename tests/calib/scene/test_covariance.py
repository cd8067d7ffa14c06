"""The covariance of a rig by stations of a scene: what points leave to it, and how the cost bends."""

import numpy as np
import pytest

from calib.refinement import CAMERA, SHARED
from calib.scene import SceneCalibration
from calib.scene.covariance import covariance_of_rig
from calib.scene.residuals import Residuals, residuals_of

pytestmark = pytest.mark.xdist_group("six sides")  # what they share is made once


@pytest.fixture
def found(of_six_sides: SceneCalibration) -> SceneCalibration:
    return of_six_sides


@pytest.fixture
def residuals(found: SceneCalibration) -> Residuals:
    return residuals_of(found.fit.scene, found.problem.observations, found.problem.spread)


def test_each_point_takes_three_degrees_of_freedom(found: SceneCalibration, residuals: Residuals) -> None:
    observations = found.problem.observations
    left = residuals.freedom(observations)
    assert left.min() > -1e-9
    assert left.max() < 2 + 1e-9
    assert left.sum() == pytest.approx(4 * len(observations.point) - 3 * found.points, rel=1e-5)


def test_changes_of_values_make_the_curvature(found: SceneCalibration, residuals: Residuals) -> None:
    observations, size = found.problem.observations, found.fit.scene.size
    step = np.random.default_rng(0).standard_normal(size) / np.sqrt(np.diag(found.fit.information))
    own, _, mixed = residuals.by_points(observations)
    curvature = residuals.by_columns(observations)[1]
    curvature -= mixed.reshape(-1, size).T @ np.linalg.solve(own, mixed).reshape(-1, size)
    changes = residuals.changes(observations, np.tile(step, (found.points, 1)))
    gradient = residuals.pulls(observations, changes).sum(axis=0)
    np.testing.assert_allclose(gradient, curvature @ step, rtol=1e-6, atol=1e-6 * np.abs(curvature @ step).max())


def test_a_principal_point_is_known_less_well_than_noisy_derivatives_say(found: SceneCalibration) -> None:
    """The cost bends less along it: its curvature is about half of Gauss's and Newton's."""
    covariance = covariance_of_rig(found.problem, found.fit)
    np.testing.assert_allclose(covariance, found.uncertainty.covariance, rtol=1e-6, atol=1e-18)
    assert np.linalg.eigvalsh(covariance).min() > -1e-15
    approximate = found.problem.covariance(found.fit)[:SHARED, :SHARED]
    ratio = np.sqrt(np.diag(covariance) / np.diag(approximate))
    assert 1.3 < ratio[CAMERA.start + 1] < 4.0
    assert 1.0 < np.median(ratio) < 1.8
