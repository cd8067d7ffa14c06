"""One small simulated room for all tests here; making it takes seconds."""

import pytest
from check_bench import CAMERA, PROJECTOR, changed, config, rig_in

from hw.settings import SimulatedRigSettings
from hw.simulated.simulation import SimulatedRoom
from scanner.checking.check import check_rig
from scanner.checking.report import CheckReport
from scanner.terminal import Terminal


@pytest.fixture(scope="session")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0), CAMERA, PROJECTOR)


@pytest.fixture(scope="session")
def usual(room: SimulatedRoom) -> CheckReport:
    """A check of the rig as it should be: whole refresh periods."""
    return check_rig(rig_in(changed(room, exposure_us=1e6 / 60)), config(), Terminal(quiet=True))
