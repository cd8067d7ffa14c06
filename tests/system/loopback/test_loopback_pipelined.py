"""Pipelined acquisition through the real path; benchmarks/bench_wrong_frames.py has the long form."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hw.loopback import Conditions
from hw.simulated import SimulatedRoom
from scanner.capture import open_capture
from tests.support.loopback_bench import Loopback, check_frames, scan

pytestmark = [pytest.mark.xdist_group("loopback"), pytest.mark.usefixtures("capture_only")]

_BURSTS = """
import random, time
while True:
    end_s = time.monotonic() + random.uniform(0.0, 0.1)
    while time.monotonic() < end_s:
        sum(range(1000))
    time.sleep(random.uniform(0.0, 0.1))
"""


@pytest.fixture
def busy() -> Iterator[None]:
    """Keep this many processors busy, now and then."""
    command = [sys.executable, "-c", _BURSTS]
    processes = [subprocess.Popen(command) for _ in range(3)]
    yield
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.usefixtures("busy")
@pytest.mark.parametrize("inverses", ["true", "false"])
def test_no_frame_of_a_wrong_picture_is_accepted_on_a_busy_computer(
    config: Path, rig: Loopback, room: SimulatedRoom, inverses: str
) -> None:
    rig.camera.change(Conditions(latency_ms=50, jitter_ms=1, missed_refreshes=0.03))
    code, folder = scan(config, "--set", f"sequence.inverses={inverses}")
    assert code in (0, 3)  # where frames come late eight times in a row, a scan ends
    planned = len(open_capture(folder).planned)
    assert check_frames(folder, room) == planned if code == 0 else check_frames(folder, room) < planned


@pytest.mark.parametrize(
    "conditions",
    [
        Conditions(latency_ms=120, jitter_ms=2, settling_ms=2, lost_packets=0.002),
        Conditions(latency_ms=20, settling_ms=4),
    ],
    ids=["late and lossy", "slow panel"],
)
def test_every_frame_shows_its_own_picture(
    config: Path, rig: Loopback, room: SimulatedRoom, conditions: Conditions
) -> None:
    rig.camera.change(conditions)
    code, folder = scan(config)
    assert code == 0
    recording = open_capture(folder)
    assert check_frames(folder, room) == len(recording.planned)
    assert recording.metadata["synchronisation"]["latency_ms"] > conditions.latency_ms - 15
