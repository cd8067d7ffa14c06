"""The covariance of a rig by stations of a scene: what points leave to it, and how the cost bends."""

import numpy as np
import pytest

from calib.refinement import CAMERA, SHARED
from calib.scene import SceneCalibration, calibrate_scene
from calib.scene.covariance import covariance_of_rig
from calib.scene.residuals import Residuals, residuals_of
from calib.self_calibration import PrincipalPoint
from tests.support.things import PROJECTOR, ThingStation, turned_stations

CAMERA_SIZE = (459, 384)


def calibrated(stations: list[ThingStation]) -> SceneCalibration:
    """The calibration by stations."""
    point = PrincipalPoint(((CAMERA_SIZE[0] - 1) / 2, (CAMERA_SIZE[1] - 1) / 2), 0.03 * CAMERA_SIZE[0])
    captures = [(station.matches, station.picture) for station in stations]
    return calibrate_scene(captures, CAMERA_SIZE, PROJECTOR, principal_point=point)


@pytest.fixture(scope="module")
def stations() -> list[ThingStation]:
    return turned_stations(4, CAMERA_SIZE, seed=3)


@pytest.fixture(scope="module")
def found(stations: list[ThingStation]) -> SceneCalibration:
    return calibrated(stations)


@pytest.fixture(scope="module")
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
