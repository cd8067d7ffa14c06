"""A thing from six sides, and its calibration, which takes ten seconds."""

import pytest

from calib.scene import SceneCalibration, calibrate_scene
from calib.self_calibration import PrincipalPoint
from tests.support.things import PROJECTOR, ThingStation, turned_stations

_CAMERA = (459, 384)


@pytest.fixture(scope="session")
def six_sides() -> list[ThingStation]:
    return turned_stations(6, _CAMERA, seed=0)


@pytest.fixture(scope="session")
def of_six_sides(six_sides: list[ThingStation]) -> SceneCalibration:
    point = PrincipalPoint(((_CAMERA[0] - 1) / 2, (_CAMERA[1] - 1) / 2), 0.03 * _CAMERA[0])
    captures = [(station.matches, station.picture) for station in six_sides]
    return calibrate_scene(captures, _CAMERA, PROJECTOR, principal_point=point)
