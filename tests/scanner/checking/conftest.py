"""One small simulated room for all tests here, because construction takes seconds; and matches of a corner."""

from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Calibration
from calib.synthetic import random_captures
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner.checking.check import check_rig
from scanner.checking.report import CheckReport, CheckRow
from scanner.io import write_matches
from scanner.ui import Terminal
from tests.support.known_rigs import SMALL_CAMERA
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


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[Calibration, list[Path]]:
    """The true calibration, and matches of three captures of a corner."""
    folder = tmp_path_factory.mktemp("captures")
    captures = random_captures(np.random.default_rng(3), 3, camera=SMALL_CAMERA, count=6_000)
    paths = [folder / f"{number}.npz" for number in range(3)]
    for path, capture in zip(paths, captures, strict=True):
        write_matches(path, capture.matches)
    return captures[0].calibration, paths
