"""The complete real path on this machine: Xvfb, a pyglet window, GigE Vision on 127.0.0.1, and a simulated room.

Each machine has one camera port, so all these tests run in one process, in sequence.
"""

import ctypes
import importlib.util
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from hw.loopback import Conditions
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from scanner import jobs
from scanner.commands import scan as scan_command
from tests.support.loopback_bench import CAMERA, CONFIG, PROJECTOR, ROOM, Keeper, Loopback


def missing_packages() -> str:
    """The missing packages of the loopback rig, or nothing."""
    missing = [name for name in ("gi", "pyglet") if importlib.util.find_spec(name) is None]
    missing += [] if shutil.which("Xvfb") else ["Xvfb"]
    try:
        ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        missing.append("Aravis")
    return ", ".join(missing)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    missing = missing_packages()
    for item in items:
        if missing and Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.skip(reason=f"THE REAL PATH IS NOT TESTED: {missing} missing; make rig"))


@pytest.fixture(scope="session")
def room() -> SimulatedRoom:
    """The room seen by the loopback camera."""
    return SimulatedRoom(SimulatedRigSettings.model_validate(ROOM), CAMERA, PROJECTOR)


@pytest.fixture(scope="session")
def keeper() -> Iterator[Keeper]:
    keeper = Keeper()
    yield keeper
    keeper.end()


@pytest.fixture
def rig(keeper: Keeper) -> Loopback:
    """A rig in normal conditions."""
    rig = keeper.rig()
    rig.camera.change(Conditions())
    return rig


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    return path


@pytest.fixture
def capture_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """End scans after decoding: the rest is slow and does not depend on the rig."""
    monkeypatch.setattr(jobs, "reconstruct", lambda found, *_, **__: found)
    monkeypatch.setattr(scan_command, "show_outcome", lambda *_: None)
