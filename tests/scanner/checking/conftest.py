"""One small simulated room for all tests here; making it takes seconds."""

import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated.simulation import SimulatedRoom
from scanner.checking.check import check_rig
from scanner.checking.report import CheckReport, CheckRow
from scanner.ui.terminal import Terminal
from tests.support.check_bench import CAMERA, PERIOD_US, PROJECTOR, changed, config, rig_in


@pytest.fixture(scope="session")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0), CAMERA, PROJECTOR)


@pytest.fixture(scope="session")
def rows_of_usual() -> list[CheckRow]:
    """The rows of the usual check in the order in which they came."""
    return []


@pytest.fixture(scope="session")
def usual(room: SimulatedRoom, rows_of_usual: list[CheckRow]) -> CheckReport:
    """A check of the rig as it should be: whole refresh periods."""
    rig = rig_in(changed(room, exposure_us=PERIOD_US))
    return check_rig(rig, config(), Terminal(quiet=True), rows_of_usual.append)
