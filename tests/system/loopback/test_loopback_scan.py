"""Complete scans through the real path."""

import json
from pathlib import Path

import numpy as np
import pytest

from hw.aravis import AravisRigSettings
from hw.open_rig import open_rig
from hw.simulated import SimulatedRoom
from scanner.capture import capture, open_capture
from scanner.commands import main
from scanner.configuration import load_config
from scanner.io import read_calibration
from scanner.patterns import Black, White
from scanner.quantities import intrinsic_errors_percent
from tests.support.loopback_bench import CAMERA, CONFIG, PROJECTOR, ROOM, Loopback, check_frames, scan

pytestmark = pytest.mark.xdist_group("loopback")


def mean_error_percent(result: Path, room: SimulatedRoom) -> float:
    found = read_calibration(result / "calibration.yaml")
    return float(np.abs(intrinsic_errors_percent(found, room.calibration)).mean())


def test_a_scan_is_as_accurate_as_on_the_simulated_rig(
    tmp_path: Path, config: Path, rig: Loopback, room: SimulatedRoom
) -> None:
    point = list(room.calibration.camera.principal_point_px)
    more = ["--set", f"camera.principal_point={{known: {point}}}", "--set", "sequence={preset: standard}"]
    code, capture_folder = scan(config, *more)
    assert code == 0
    recording = open_capture(capture_folder)
    assert check_frames(capture_folder, room) == len(recording.patterns) > 30
    assert recording.metadata["devices"]["camera"] == "Aravis Fake loopback"
    assert recording.metadata["devices"]["exposure"] == "33.33 ms"
    assert recording.metadata["synchronisation"]["overlapping"] is True
    assert {exposure for exposure, _ in recording.read_back} == {33333.0}
    report = (capture_folder.parent / "report.html").read_text()
    for words in (
        "Aravis Fake loopback",
        "light after a flip",
        "frames dropped, and taken again",
        "pictures in the pipeline",
    ):
        assert words in report

    simulated = tmp_path / "simulated"
    code = main(
        ["--config", str(config), "--out", str(simulated), "--quiet", *more, "--set", f"rig={json.dumps(ROOM)}"]
    )
    assert code == 0
    error, without_hardware = (mean_error_percent(result, room) for result in (capture_folder.parent, simulated))
    assert 0.01 < without_hardware < 1
    assert 0.01 < error < max(1.0, 2 * without_hardware)


@pytest.mark.parametrize(
    ("settings", "kind", "channels"),
    [
        ("pixel_format: Mono16", np.uint16, 1),
        ("pixel_format: BayerRG8", np.uint8, 3),
        ("pixel_format: Mono8, trigger: free-run", np.uint8, 1),
    ],
)
def test_other_settings_take_effect(
    config: Path, rig: Loopback, settings: str, kind: type[np.uint8] | type[np.uint16], channels: int
) -> None:
    config.write_text(CONFIG.replace("packet_size: 8000", f"packet_size: 8000, {settings}"))
    chosen = load_config(config)
    with open_rig(chosen.required_rig, chosen.camera_size, chosen.projector_size) as opened:
        white, black = (frame.image for _, frame in capture(opened.rig, (White(), Black())).frames)
    assert white.dtype == kind
    assert white.shape == ((*CAMERA[::-1], channels) if channels > 1 else CAMERA[::-1])
    full = np.iinfo(kind).max
    assert 0.5 * full < np.percentile(white, 99.5) < full
    assert np.percentile(black, 99.5) < 0.2 * full


@pytest.mark.usefixtures("rig")
def test_devices_are_listed_with_lines_to_paste(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["devices"]) == 0
    text = capsys.readouterr().out
    assert "Aravis Fake loopback at 127.0.0.1" in text
    pasted = tmp_path / "pasted.yaml"
    pasted.write_text(text.partition("To paste into a configuration:")[2])
    found = load_config(pasted)
    assert (found.camera_size, found.projector_size) == (CAMERA, PROJECTOR)
    assert isinstance(found.rig, AravisRigSettings)
    assert (found.rig.camera, found.rig.pixel_format) == ("Aravis-Fake-loopback", "Mono8")
    assert (found.rig.screen, found.rig.refresh_hz) == ("320x180+0+0", 60)
