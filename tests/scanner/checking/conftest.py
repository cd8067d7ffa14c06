"""One small simulated room for all tests here, because construction takes seconds."""

import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner.checking.check import check_rig
from scanner.checking.report import CheckReport, CheckRow
from scanner.ui import Terminal
from tests.support.rig_bench import CAMERA, PERIOD_US, PROJECTOR, changed, config, rig_in


@pytest.fixture(scope="session")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0), CAMERA, PROJECTOR)


@pytest.fixture(scope="session")
def rows_of_usual() -> list[CheckRow]:
    """The rows of a check under normal conditions, in order."""
    return []


@pytest.fixture(scope="session")
def usual(room: SimulatedRoom, rows_of_usual: list[CheckRow]) -> CheckReport:
    """A check under normal conditions, with exposures of whole refresh periods."""
    rig = rig_in(changed(room, exposure_us=PERIOD_US))
    return check_rig(rig, config(), Terminal(quiet=True), rows_of_usual.append)
