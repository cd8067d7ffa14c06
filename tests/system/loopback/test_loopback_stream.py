"""A webcam through the real path: a window, its light in a simulated room, JPEGs over HTTP, OpenCV's capture."""

import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from hw.loopback.launcher import CameraProcess, camera_process, shown_on, virtual_screen
from hw.loopback.settings import Conditions, LoopbackSettings, WebcamSettings
from hw.simulated.simulation import SimulatedRoom
from scanner.capture.recording import open_capture
from scanner.commands.main import main
from scanner.io.calibration_file import read_calibration
from scanner.quantities.calibration_numbers import device_quantities, intrinsic_errors_percent
from tests.support.loopback_bench import CAMERA, PROJECTOR, after_frames, scan

pytestmark = pytest.mark.xdist_group("loopback")

_LOOPBACK_DEVICES = [
    each.parent.name
    for each in Path("/sys/class/video4linux").glob("video*/name")
    if "loopback" in each.read_text().lower()
]
_USUAL = Conditions(sending_jitter_ms=8)


@pytest.fixture(scope="module")
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def webcam(port: int) -> Iterator[CameraProcess]:
    with ExitStack() as running:
        screen = running.enter_context(virtual_screen(PROJECTOR))
        running.enter_context(shown_on(screen))
        settings = LoopbackSettings(camera_size=CAMERA, conditions=_USUAL, webcam=WebcamSettings(port=port))
        yield running.enter_context(camera_process(screen, settings))


@pytest.fixture
def config(tmp_path: Path, port: int) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(
        f"""
rig: {{backend: opencv, camera: "http://127.0.0.1:{port}/video", refresh_hz: 60}}
camera: {{width: {CAMERA[0]}, height: {CAMERA[1]}}}
projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}
sequence: {{preset: quick, cell: 12, inverses: true}}
corner: {{squareness_deg: 0}}
lens: {{decentering: 0}}
"""
    )
    return path


def test_a_webcam_scans_a_room(config: Path, webcam: CameraProcess, room: SimulatedRoom) -> None:
    webcam.change(_USUAL)
    point = list(room.calibration.camera.principal_point_px)
    more = ["--set", f"camera.principal_point={{known: {point}}}", "--set", "sequence={preset: standard}"]
    code, capture = scan(config, *more)
    assert code == 0
    found = read_calibration(capture.parent / "calibration.yaml")
    # Of 306 × 256 pixels; within 1 % is what 640 × 480 of them come to (make scan-loopback-stream).
    assert 0.005 < np.abs(intrinsic_errors_percent(found, room.calibration)).mean() < 2
    known = [each for device in ("camera", "projector") for each in device_quantities(device, found, room.calibration)]
    sigmas = [abs(each.error_sigmas) for each in known if each.error_sigmas is not None]
    assert len(sigmas) >= 6
    assert 0 < max(sigmas) < 4
    measured = open_capture(capture).metadata["synchronisation"]
    assert measured["latency_ms"] > 130  # the display's 50 ms, and the queue's three frames
    assert measured["averaged_frames"] == 2


@pytest.mark.parametrize("fault", ["silent", "frozen"])
def test_a_stream_that_fails_is_named_and_taken_up_again(
    config: Path, webcam: CameraProcess, capsys: pytest.CaptureFixture[str], fault: str
) -> None:
    words = {"silent": "no frame for 4 s", "frozen": "its picture is frozen"}
    webcam.change(_USUAL)
    after_frames(3, config, lambda: webcam.change(_USUAL.model_copy(update={"fault": fault})))
    code, capture = scan(config)
    assert code == 3
    assert words[fault] in capsys.readouterr().err
    taken = len(open_capture(capture).patterns)
    assert taken >= 3
    if fault == "silent":
        webcam.change(_USUAL)
        out = config.with_name("whole")
        assert main(["--resume", str(capture.parent), "--out", str(out), "--quiet"]) in (0, 4)
        recording = open_capture(out / "capture")
        assert len(recording.patterns) >= len(recording.planned) > taken
        assert recording.metadata["resumed"]["after_frames"] == taken


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"automatic_exposure": True}, "its automatic exposure is on"),
        ({"fault": "rotated"}, f"expected frames of 306 × 256, but it delivers {CAMERA[1]} × {CAMERA[0]}"),
    ],
    ids=["automatic", "rotated"],
)
def test_a_stream_that_will_not_do_is_named_before_anything_is_captured(
    config: Path, webcam: CameraProcess, capsys: pytest.CaptureFixture[str], change: dict[str, object], words: str
) -> None:
    webcam.change(_USUAL.model_copy(update=change))
    code, capture = scan(config)
    assert code == 3
    assert words in capsys.readouterr().err
    assert not capture.exists()


@pytest.mark.skipif(not _LOOPBACK_DEVICES, reason="the kernel has no V4L2 loopback device (modprobe v4l2loopback)")
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg, which would feed the V4L2 device, is missing")
@pytest.mark.usefixtures("capture_only")
def test_a_webcam_of_the_kernel(config: Path, webcam: CameraProcess, port: int) -> None:
    webcam.change(_USUAL)
    number = int(_LOOPBACK_DEVICES[0].removeprefix("video"))
    command = ["ffmpeg", "-loglevel", "error", "-i", f"http://127.0.0.1:{port}/video"]
    with subprocess.Popen([*command, "-f", "v4l2", "-pix_fmt", "yuv420p", f"/dev/video{number}"]) as feeding:
        try:
            code, capture = scan(config, "--set", f"rig.camera={number}")
        finally:
            feeding.terminate()
    assert code == 0
    assert len(open_capture(capture).patterns) > 10
