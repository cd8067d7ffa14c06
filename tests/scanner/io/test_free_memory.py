"""Memory is refused before any is taken, whether the machine or a limit of the shell sets the end."""

from pathlib import Path

import pytest

from scanner.errors import InputError
from scanner.io import free_bytes, free_memory, require_memory, total_bytes
from tests.support.command_line import run
from tests.support.little_memory import little_memory

pytestmark = pytest.mark.skipif(not Path("/proc/meminfo").exists(), reason="the system does not report its memory")


def test_a_limit_of_the_shell_counts() -> None:
    free, total = free_bytes(), total_bytes()
    assert 0 < free < total
    with little_memory():
        allowed = free_bytes()
        with pytest.raises(InputError, match=r"maps take about 1\.0 GB of memory, and 0\.\d GB are free"):
            require_memory(1_000_000_000, "maps", "ask for less")
    assert 0 < allowed < 1_000_000_000


def test_a_cloud_for_a_huge_camera_is_refused_before_its_matches_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    matches = tmp_path / "matches.npz"
    matches.touch()
    monkeypatch.setattr(free_memory, "free_bytes", lambda: 8_000_000_000)
    size = ("--set", "camera.width=15000", "--set", "camera.height=15000")
    assert run("calibrate", matches, "--config", "configs/room-sim.yaml", *size, "--out", tmp_path / "out") == 2
    message = " ".join(capsys.readouterr().err.split())
    assert "for a camera of 15000 × 15000 pixels take about 11.2 GB of memory, and 8.0 GB are free" in message


def test_what_a_system_does_not_report_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(free_memory, "_MEMINFO", Path("/nowhere"))
    require_memory(1 << 60, "maps", "ask for less")
    assert total_bytes() is None
