"""A projector's picture that is shifted from station to station: the shifts are estimated with the rig."""

from dataclasses import replace

import numpy as np
import pytest

from calib.scene import DRIFTED, SceneCalibration, calibrate_scene, drift_findings
from calib.self_calibration import PrincipalPoint
from tests.support.things import PROJECTOR, ThingStation, true_rig, turned_stations

CAMERA_SIZE = (612, 512)
SHIFT_PX = np.array([[0.12, -0.05], [-0.08, 0.1], [0.0, 0.15], [-0.15, -0.1]])


@pytest.fixture(scope="module")
def stations() -> list[ThingStation]:
    return turned_stations(4, CAMERA_SIZE, seed=3)


@pytest.fixture(scope="module")
def found(stations: list[ThingStation]) -> SceneCalibration:
    captures = [
        (replace(station.matches, projector_px=station.matches.projector_px + shift), station.picture)
        for station, shift in zip(stations, SHIFT_PX, strict=True)
    ]
    point = PrincipalPoint(((CAMERA_SIZE[0] - 1) / 2, (CAMERA_SIZE[1] - 1) / 2), 0.03 * CAMERA_SIZE[0])
    return calibrate_scene(captures, CAMERA_SIZE, PROJECTOR, principal_point=point)


def test_shifts_are_found_but_for_what_the_principal_point_takes(found: SceneCalibration) -> None:
    shift_px = found.fit.scene.shift_px
    assert shift_px is not None
    difference = shift_px - SHIFT_PX[list(found.stations)]
    assert np.abs(difference - difference.mean(axis=0)).max() < 0.03
    assert 0.05 < found.problem.spread.drift_px < 0.2


def test_the_rig_is_as_good_as_its_sigmas_say(found: SceneCalibration, stations: list[ThingStation]) -> None:
    error = found.uncertainty.rig.step_to(true_rig(stations[0].calibration))
    sigma = np.sqrt(np.diag(found.uncertainty.covariance))
    assert 0.3 < np.sqrt(np.mean((error / sigma) ** 2)) < 2.0
    assert np.abs(error[[0, 8]]).max() < 2e-3
    assert found.problem.spread.lifted < 0.4


def test_derivatives_by_shifts_are_those_of_the_cost(found: SceneCalibration) -> None:
    problem, scene = found.problem, found.fit.scene
    moved = problem.evaluate_after(found.fit, np.zeros(scene.size))
    for column in scene.columns.of_shifts.ravel().tolist():
        step = np.zeros(scene.size)
        step[column] = 1e-3
        ahead, behind = (problem.evaluate_after(moved, sign * step).cost for sign in (1, -1))
        bend = (ahead + behind - 2 * moved.cost) / 2e-6
        assert (ahead - behind) / 4e-3 == pytest.approx(moved.gradient[column], abs=2e-4 * abs(bend))


def test_a_drift_that_clouds_would_show_is_told() -> None:
    (finding,) = drift_findings(0.21)
    assert finding.kind == DRIFTED
    assert finding.data == {"drift_px": 0.21}
    assert not drift_findings(0.02)
