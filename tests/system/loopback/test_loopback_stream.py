"""A webcam through the real path: a window, its light in a simulated room, JPEGs over HTTP, OpenCV's capture."""

import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Calibration
from hw.loopback import (
    CameraProcess,
    Conditions,
    LoopbackSettings,
    WebcamSettings,
    camera_process,
    shown_on,
    virtual_screen,
)
from hw.settings import SimulatedRigSettings
from hw.simulated import place_room, true_calibration
from hw.timing import stream_calibration
from scanner.capture import open_capture
from scanner.io import read_calibration
from scanner.quantities import device_quantities, intrinsic_errors_percent
from tests.support.loopback_bench import scan

pytestmark = pytest.mark.xdist_group("loopback")

_LOOPBACK_DEVICES = [
    each.parent.name
    for each in Path("/sys/class/video4linux").glob("video*/name")
    if "loopback" in each.read_text().lower()
]
CAMERA, PROJECTOR = (448, 336), (640, 360)
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
        settings = LoopbackSettings(
            camera_size=CAMERA,
            room=SimulatedRigSettings(seed=0, furniture=False, interreflection=False),
            conditions=_USUAL,
            webcam=WebcamSettings(port=port),
        )
        yield running.enter_context(camera_process(screen, settings))


@pytest.fixture(scope="module")
def truth() -> Calibration:
    known = true_calibration(
        place_room(SimulatedRigSettings(seed=0, furniture=False, interreflection=False), CAMERA, PROJECTOR)
    )
    assert known is not None
    return known


@pytest.fixture
def config(tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(stream_calibration, "_LONGEST_LATENCY_S", 0.6)  # this camera is known
    monkeypatch.setattr(stream_calibration, "_WATCHED_S", 1.5)
    path = tmp_path / "room.yaml"
    path.write_text(
        f"""
rig: {{backend: opencv, camera: "http://127.0.0.1:{port}/video", refresh_hz: 60}}
camera: {{width: {CAMERA[0]}, height: {CAMERA[1]}}}
projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}
sequence: {{preset: quick}}
corner: {{squareness_deg: 0}}
"""
    )
    return path


@pytest.mark.usefixtures("webcam")
def test_a_webcam_scans_a_room(config: Path, truth: Calibration) -> None:
    point = list(truth.camera.principal_point_px)
    code, capture = scan(config, "--set", f"camera.principal_point={{known: {point}}}")
    assert code == 0
    found = read_calibration(capture.parent / "calibration.yaml")
    assert 0.005 < np.abs(intrinsic_errors_percent(found, truth)).mean() < 1
    known = [each for device in ("camera", "projector") for each in device_quantities(device, found, truth)]
    sigmas = [abs(each.error_sigmas) for each in known if each.error_sigmas is not None]
    assert len(sigmas) >= 6
    assert 0 < max(sigmas) < 4
    measured = open_capture(capture).metadata["synchronisation"]
    assert measured["latency_ms"] > 130  # the display's 50 ms, and the queue's three frames
    assert measured["averaged_frames"] == 2


@pytest.mark.skipif(not _LOOPBACK_DEVICES, reason="the kernel has no V4L2 loopback device (modprobe v4l2loopback)")
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg, which would feed the V4L2 device, is missing")
@pytest.mark.usefixtures("capture_only", "webcam")
def test_a_v4l2_webcam_scans(config: Path, port: int) -> None:
    number = int(_LOOPBACK_DEVICES[0].removeprefix("video"))
    command = ["ffmpeg", "-loglevel", "error", "-i", f"http://127.0.0.1:{port}/video"]
    with subprocess.Popen([*command, "-f", "v4l2", "-pix_fmt", "yuv420p", f"/dev/video{number}"]) as feeding:
        try:
            code, capture = scan(config, "--set", f"rig.camera={number}")
        finally:
            feeding.terminate()
    assert code == 0
    assert len(open_capture(capture).patterns) > 10
