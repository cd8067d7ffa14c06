"""`scan check` through the real path: the camera's exposure is optimised and written."""

from pathlib import Path

import pytest

from scanner.commands import main
from scanner.configuration import load_config
from tests.support.loopback_bench import Loopback

pytestmark = pytest.mark.xdist_group("loopback")

PERIOD_US = 1e6 / 60


def test_a_check_measures_and_writes_the_exposure(
    config: Path, rig: Loopback, capsys: pytest.CaptureFixture[str]
) -> None:
    text = config.read_text().replace("33333", "100000")
    config.write_text(text)
    assert main(["check", "--config", str(config), "--write"]) in (0, 4)
    table = " ".join(capsys.readouterr().out.split())
    for words in ("ok camera Aravis Fake loopback", "light comes", "is clipped", "gamma 2.2", "transfer"):
        assert words in table
    changed = load_config(config)
    assert changed.rig.exposure_us == pytest.approx(2 * PERIOD_US, rel=1e-3)
    assert changed.projector.known_response.gamma == pytest.approx(2.2, abs=0.05)
    assert config.with_name("room.yaml.bak").read_text() == text


def test_a_camera_failure_gives_a_row_and_exit_code_3(
    config: Path, rig: Loopback, capsys: pytest.CaptureFixture[str]
) -> None:
    rig.camera.process.kill()
    assert main(["check", "--config", str(config)]) == 3
    captured = capsys.readouterr()
    assert "failed" in captured.out
    assert "no camera answers" in captured.err
