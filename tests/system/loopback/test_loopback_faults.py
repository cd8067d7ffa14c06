"""Faults of real devices, injected into the loopback rig during scans.

A scan completes with every frame of its own pattern. Or it stops with exit code 3, a message that names the device and
the remedy, and every captured frame on disk.
"""

import ctypes
import gc
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hw.aravis import backend as aravis
from hw.loopback import Conditions, shown_on, virtual_screen
from hw.open_rig import open_rig
from hw.simulated import SimulatedRoom
from scanner.capture import capture, open_capture
from scanner.commands import main
from scanner.configuration import load_config
from scanner.io import read_image, write_png
from scanner.patterns import Black, White
from tests.support.loopback_bench import (
    CAMERA,
    CONFIG,
    PROJECTOR,
    Keeper,
    Loopback,
    after_frames,
    broken_off,
    check_frames,
    scan,
)

pytestmark = [pytest.mark.xdist_group("loopback"), pytest.mark.usefixtures("capture_only")]

FRAMES = 28  # of the sequence in CONFIG


def stopped_scan(config: Path, capsys: pytest.CaptureFixture[str], *words: str) -> Path:
    """Expect a scan to stop with exit code 3 and these words; returns the folder of the capture."""
    code, folder = scan(config)
    message = capsys.readouterr().err
    assert code == 3, message
    for word in words:
        assert word in message
    assert any(advice in message for advice in ("Check ", "Close ", "Set ", "set ", "Change "))
    assert "Traceback" not in message
    return folder


@pytest.mark.parametrize("latency_ms", [0, 120])
def test_any_latency_is_measured(config: Path, rig: Loopback, room: SimulatedRoom, latency_ms: float) -> None:
    rig.camera.change(Conditions(latency_ms=latency_ms))
    code, folder = scan(config)
    assert code == 0
    assert check_frames(folder, room) == FRAMES
    measured = open_capture(folder).metadata["synchronisation"]["latency_ms"]
    assert -15 < measured - latency_ms < 30  # tests beside this one keep the processors busy


def test_lost_packets_are_recovered(
    config: Path, rig: Loopback, room: SimulatedRoom, capsys: pytest.CaptureFixture[str]
) -> None:
    rig.camera.change(Conditions(lost_packets=0.05))
    code, folder = scan(config)
    if code == 0:
        assert check_frames(folder, room) == FRAMES
        assert open_capture(folder).metadata["synchronisation"]["retriggered_frames"] > 0
    else:
        message = capsys.readouterr().err
        assert code == 3
        assert "camera Aravis Fake loopback" in message
        assert "packet_size" in message
        assert not folder.exists() or check_frames(folder, room) > 0


def test_heavy_packet_loss_stops_the_scan(config: Path, rig: Loopback, capsys: pytest.CaptureFixture[str]) -> None:
    rig.camera.change(Conditions(lost_packets=0.9))
    folder = stopped_scan(config, capsys, "its frames do not arrive", "(packet_size)")
    assert not folder.exists()


def test_the_camera_dies(config: Path, rig: Loopback, room: SimulatedRoom, capsys: pytest.CaptureFixture[str]) -> None:
    after_frames(5, config, rig.camera.process.kill)
    folder = stopped_scan(config, capsys, "camera Aravis Fake loopback", "cable and power", "frames captured so far")
    assert check_frames(folder, room) >= 5


def test_the_camera_stops_for_a_while(
    config: Path, rig: Loopback, room: SimulatedRoom, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop() -> None:
        rig.camera.process.send_signal(signal.SIGSTOP)
        time.sleep(3.0)
        rig.camera.process.send_signal(signal.SIGCONT)

    after_frames(5, config, stop)
    code, folder = scan(config)
    if code == 0:
        assert check_frames(folder, room) == FRAMES
    else:
        assert code == 3
        assert check_frames(folder, room) >= 5
        assert "camera Aravis Fake loopback" in capsys.readouterr().err


def test_the_camera_starts_late(
    config: Path, keeper: Keeper, room: SimulatedRoom, capsys: pytest.CaptureFixture[str]
) -> None:
    keeper.end()
    with virtual_screen(PROJECTOR) as screen, shown_on(screen):
        folder = stopped_scan(config, capsys, "no camera answers to '127.0.0.1'", "Found: none", "scan devices")
    assert not folder.exists()
    keeper.rig()
    code, folder = scan(config)
    assert code == 0
    assert check_frames(folder, room) == FRAMES


def test_another_program_controls_the_camera(config: Path, rig: Loopback, capsys: pytest.CaptureFixture[str]) -> None:
    settings = load_config(config)
    with aravis.load().AravisCamera(settings.rig, CAMERA, 10_000.0):
        stopped_scan(config, capsys, "camera Aravis Fake loopback", "another program controls it")


def test_the_screen_dies(config: Path, rig: Loopback, room: SimulatedRoom, capsys: pytest.CaptureFixture[str]) -> None:
    after_frames(5, config, rig.screen.process.kill)
    folder = stopped_scan(config, capsys, "projector on screen 0", "320x180", "is gone", "frames captured so far")
    assert check_frames(folder, room) >= 5


def test_after_ctrl_c_a_resumed_scan_takes_the_missing_frames_unless_something_moved(
    config: Path, rig: Loopback, room: SimulatedRoom, capsys: pytest.CaptureFixture[str]
) -> None:
    code, message = broken_off(config, signal.SIGINT)  # killed, it would leave the camera to its heartbeat's time-out
    assert code == 130, message
    assert "interrupted" in message
    left, out = config.with_name("result-incomplete"), config.with_name("whole")
    before = check_frames(left / "capture", room)
    assert before >= 5
    frame = left / "capture" / "frames" / "000.png"
    white = read_image(frame)
    write_png(frame, white // 2)  # as if it had been half as bright when it was shown first
    resume = ["--resume", str(left), "--out", str(out), "--quiet"]
    assert main(resume) == 2
    assert "frame 0 (frames/000.png) was shown again, and it is" in capsys.readouterr().err
    assert not out.exists()
    write_png(frame, white)
    assert main(resume) == 0
    assert check_frames(out / "capture", room) > FRAMES
    assert open_capture(out / "capture").metadata["resumed"]["after_frames"] == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("packet_size: 8000", "pixel_format: Mono12"), ("Mono12",)),
        (("packet_size: 8000", "gain: 99"), ("Gain", "99")),
        (("packet_size: 8000", "trigger: line, trigger_line: Line9"), ("Line9",)),
        ((f"width: {CAMERA[0]}", "width: 400"), ("Width", "400")),
        (("width: 320", "width: 640"), ("screen 0", "320x180", "640 × 180")),
        (("packet_size: 8000", "screen: 3"), ("no screen is called", "screen 0 'screen', 320x180")),
        (("camera: 127.0.0.1", "camera: nobody"), ("'nobody'", "Found: Aravis Fake loopback at 127.0.0.1")),
    ],
)
def test_settings_beyond_the_devices_are_refused(
    config: Path, rig: Loopback, capsys: pytest.CaptureFixture[str], change: tuple[str, str], words: tuple[str, ...]
) -> None:
    config.write_text(CONFIG.replace(*change))
    stopped_scan(config, capsys, *words)


def test_many_scans_in_one_process_leave_nothing_behind(config: Path, rig: Loopback) -> None:
    settings = load_config(config)

    def one_scan() -> None:
        with open_rig(settings.required_rig, settings.camera_size, settings.projector_size) as opened:
            assert len(list(capture(opened.rig, (White(), Black())).frames)) == 2

    one_scan()
    seen = [resources()]
    for _ in range(5):
        one_scan()
        seen.append(resources())
    memory_mb, files, threads = np.array(seen).T
    assert files[-1] <= files[0]
    assert threads[-1] <= threads[0]
    # What is left behind grows with every scan (the buffers of one are 0.3 MB); the allocator grows once in a while.
    assert np.median(np.diff(memory_mb)) < 0.2


def resources() -> tuple[float, int, int]:
    """Memory in MB, open files and threads of this process, once what is free has gone back to the system."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return (
        pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        sum(1 for _ in Path("/proc/self/fd").iterdir()),
        threading.active_count(),
    )
