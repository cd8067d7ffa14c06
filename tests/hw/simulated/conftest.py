"""One small simulated room for all tests here, because construction takes seconds."""

import pytest

from hw.settings import SimulatedRigSettings
from hw.simulated.simulation import SimulatedRoom

CAMERA_SIZE = (306, 256)
PROJECTOR_SIZE = (214, 120)


@pytest.fixture(scope="session")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0), CAMERA_SIZE, PROJECTOR_SIZE)
