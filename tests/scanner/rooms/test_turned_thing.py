"""A thing rotated by 1.4° on a turntable, given to `scan room`: false planes must not determine its pose."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.refusal import RefusalError
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.solve import solve_room
from scanner.stations import RigStart
from scanner.ui import Terminal
from tests.support.findings import kinds_of
from tests.support.things import ThingStation, between, config_for, decoded, thing_stations

CAMERA = (230, 192)


def solved(stations: list[ThingStation]) -> SolvedRoom:
    rig = stations[0].calibration
    start = RigStart(rig.in_baselines, None, {}, rig)
    return solve_room(decoded(stations, CAMERA), start, config_for(CAMERA), Terminal(quiet=True))


def test_surfaces_correct_poses_from_false_planes() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    stations = thing_stations([0, 1], CAMERA, seed=2, step_deg=1.4, background=False)
    found = solved(stations)
    assert "by-surfaces" in kinds_of(found.findings)
    one, other = found.stations
    off = between(one.place, other.place).rotation @ between(stations[0].place, stations[1].place).rotation.T
    error_deg = np.degrees(Rotation.from_matrix(off).magnitude())
    assert 0 < error_deg < 0.03
    assert error_deg < 5 * np.linalg.norm(other.sigma_deg)


def test_an_object_turned_in_front_of_a_static_background_is_refused() -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    stations = thing_stations([0, 1], CAMERA, seed=1, step_deg=1.4, background=True, kind="box")
    with pytest.raises(RefusalError, match="Station 1, Station 2 do not coincide"):
        solved(stations)
