"""The next station that is proposed gives what was predicted of it."""

import numpy as np
import pytest

from calib.scene import SceneCalibration, calibrate_scene
from calib.self_calibration import PrincipalPoint
from tests.support.things import PROJECTOR, ThingStation, turned_before_camera, turned_stations

CAMERA = (306, 256)
CENTRE = PrincipalPoint(((CAMERA[0] - 1) / 2, (CAMERA[1] - 1) / 2), 0.03 * CAMERA[0])


def calibrated(stations: list[ThingStation]) -> SceneCalibration:
    captures = [(station.matches, station.picture) for station in stations]
    return calibrate_scene(captures, CAMERA, PROJECTOR, principal_point=CENTRE)


def focal_sigmas(found: SceneCalibration) -> tuple[float, float]:
    sigma = np.sqrt(np.diag(found.uncertainty.covariance))
    return float(sigma[0]), float(sigma[8])


def test_a_further_station_gives_the_predicted_sigmas() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    taken = turned_stations(4, CAMERA, seed=2)
    stations = [*taken[1:], taken[0]]  # the newest is as the thing stands first
    before = calibrated(stations)
    best = before.next_station()
    assert best is not None
    after = calibrated([*stations, turned_before_camera(2, CAMERA, best.axis, best.turn_deg)])
    assert after.stations == (0, 1, 2, 3, 4)
    for now, predicted, then in zip(
        focal_sigmas(before), (best.camera_focal, best.projector_focal), focal_sigmas(after), strict=True
    ):
        assert 0.3 * now < predicted < now
        assert 0.6 < then / predicted < 1.5
