"""Scans with a network camera through OpenCV's capture: failures are named, and frames kept."""

import os
import signal
import socket
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Self

import cv2
import numpy as np
import pytest

from hw import opencv, real_devices
from hw.loopback import MjpegServer
from hw.rig import settable_exposure
from hw.settings import SimulatedRigSettings
from hw.simulated import SimulatedRoom
from hw.timing import frame_reader, stream_calibration
from scanner import jobs
from scanner.capture import open_capture
from scanner.commands import main
from scanner.commands import scan as scan_command
from scanner.console import Activity, ConsoleSettings, IdlePicture, Worker
from scanner.patterns import draw
from tests.support.loopback_bench import SimulatedWindow, after_frames
from tests.support.notebook import Notebook, until

PERIOD_S = 1 / 60
_NOISE = 1.0  # grey levels
_QUEUE = 2  # frames that wait before one leaves


class Phone:
    """Streams from `address` while the `with` block lasts. `changed` modifies each frame (H, W, 3); None drops it.
    `stop` ends the server too, and `connect` starts again.
    """

    def __init__(self, room: SimulatedRoom) -> None:
        self._room = room
        self._rng = np.random.default_rng(0)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = int(probe.getsockname()[1])
        self.address = f"http://127.0.0.1:{self._port}/video"
        self._server: MjpegServer | None = None
        self._changing = Lock()
        self._ending = Event()
        self._thread = Thread(target=self._run, daemon=True)
        self.changed: Callable[[np.ndarray], np.ndarray | None] = lambda image: image
        self.shown = 0
        self._light: np.ndarray | None = None

    def __enter__(self) -> Self:
        self.connect()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self.stop()

    def connect(self) -> None:
        with self._changing:  # one thread may stop it, and another want it back at once
            self._server = MjpegServer("127.0.0.1", self._port, 3).__enter__()

    def stop(self) -> None:
        with self._changing:
            if self._server is not None:
                self._server.__exit__()
            self._server = None

    def light(self, picture: np.ndarray) -> None:
        """Set the picture that the projector shows."""
        self._light = self._room.electrons(picture) * (255 / self._room.sensor.full_well_electrons)
        self.shown += 1

    def _run(self) -> None:
        waiting: deque[np.ndarray] = deque()
        while not self._ending.wait(PERIOD_S):
            if self._light is None:
                continue
            seen = self._light[:, :, None] * (0.8, 1.0, 0.9) + _NOISE * self._rng.standard_normal(
                (*self._light.shape, 3)
            )
            waiting.append(np.rint(seen).clip(0, 255).astype(np.uint8))
            if len(waiting) <= _QUEUE:
                continue
            image, server = self.changed(waiting.popleft()), self._server
            if image is not None and server is not None:
                server.send(bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]))


SIZE, PROJECTOR = (160, 120), (160, 96)
BEFORE = 4  # frames that are captured before anything happens


@pytest.fixture(scope="module")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0, interreflection=False, ambient=0), SIZE, PROJECTOR)


@pytest.fixture
def phone(monkeypatch: pytest.MonkeyPatch, room: SimulatedRoom) -> Iterator[Phone]:
    """A phone that sees the light of the window, with short timeouts."""
    with Phone(room) as phone:

        @contextmanager
        def window(*_: object) -> Iterator[SimulatedWindow]:
            yield SimulatedWindow(PROJECTOR, phone.light)

        phone.light(np.zeros(PROJECTOR[::-1], np.uint8))
        monkeypatch.setattr(real_devices, "ScreenProjector", window)
        monkeypatch.setattr(stream_calibration, "_LONGEST_LATENCY_S", 0.3)
        monkeypatch.setattr(stream_calibration, "_WATCHED_S", 0.5)
        monkeypatch.setattr(frame_reader, "_NOTHING_S", 0.8)
        monkeypatch.setattr(opencv, "_OPENING_MS", 1500)
        monkeypatch.setattr(jobs, "reconstruct", lambda found, *_, **__: found)
        monkeypatch.setattr(scan_command, "show_outcome", lambda *_: None)
        phone.shown = 0
        yield phone


@pytest.fixture
def config(tmp_path: Path, phone: Phone) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(
        f"""
rig: {{backend: opencv, camera: "{phone.address}", refresh_hz: 60}}
camera: {{width: {SIZE[0]}, height: {SIZE[1]}}}
projector: {{width: {PROJECTOR[0]}, height: {PROJECTOR[1]}}}
sequence: {{preset: quick, cell: 12, inverses: true}}
"""
    )
    return path


def scan(config: Path, *more: str) -> tuple[int, Path]:
    out = config.with_name("result")
    code = main(["--config", str(config), "--out", str(out), "--quiet", *more])
    return code, (out if code == 0 else out.with_name("result-incomplete")) / "capture"


def repeated() -> Callable[[np.ndarray], np.ndarray]:
    kept: list[np.ndarray] = []

    def frozen(image: np.ndarray) -> np.ndarray:
        kept[:] = kept or [image]
        return kept[0]

    return frozen


def changed(change: Callable[[np.ndarray], np.ndarray | None]) -> Callable[[Phone], None]:
    return lambda phone: setattr(phone, "changed", change)


@pytest.mark.parametrize(
    ("fail", "words"),
    [
        (
            changed(lambda image: cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE)),
            "expected frames of 160 × 120, but it delivers 120 × 160",
        ),
        (
            changed(lambda image: cv2.rotate(image, cv2.ROTATE_180)),
            "it sees another picture than when the capture began",
        ),
        (changed(repeated()), "its picture is frozen"),
        (changed(lambda _: None), "no frame for 1 s"),
        (lambda phone: phone.stop(), "its stream has ended"),
    ],
    ids=["another size", "rotated", "frozen", "silent", "gone"],
)
def test_a_camera_failure_during_a_scan_is_named(
    config: Path,
    phone: Phone,
    room: SimulatedRoom,
    capsys: pytest.CaptureFixture[str],
    fail: Callable[[Phone], object],
    words: str,
) -> None:
    after_frames(BEFORE, config, lambda: fail(phone))
    code, capture = scan(config)
    assert code == 3
    assert_named(capsys, phone, words)
    assert captured(capture, room) >= BEFORE


def test_after_ctrl_c_a_scan_takes_the_missing_frames(config: Path, phone: Phone, room: SimulatedRoom) -> None:
    after_frames(BEFORE, config, lambda: os.kill(os.getpid(), signal.SIGINT))
    code, capture = scan(config)
    assert code == 130
    taken = captured(capture, room)
    assert taken >= BEFORE
    whole = config.with_name("whole")
    assert main(["--resume", str(capture.parent), "--out", str(whole), "--quiet"]) == 0
    recording = open_capture(whole / "capture")
    assert recording.metadata["resumed"]["after_frames"] == taken
    assert captured(whole / "capture", room) >= len(recording.planned)
    assert phone.shown > len(recording.planned)


def assert_named(capsys: pytest.CaptureFixture[str], phone: Phone, words: str) -> None:
    message = " ".join(capsys.readouterr().err.split())
    assert f"camera {phone.address}: {words}" in message
    assert "Traceback" not in message


def captured(capture: Path, room: SimulatedRoom) -> int:
    """The number of frames, each of its own pattern."""
    recording = open_capture(capture)
    for pattern, frame in recording.stream().frames:
        own = room.electrons(draw(pattern, PROJECTOR)) * (255 / room.sensor.full_well_electrons)
        assert np.sqrt(np.mean((frame.image[:, :, 1] - own) ** 2)) < 3, pattern
    return len(recording.patterns)


def test_the_console_shows_what_the_camera_sees(config: Path, phone: Phone) -> None:
    page = Notebook()
    worker = Worker(ConsoleSettings(config), page)
    worker.start()
    try:
        assert worker.request(Activity.LIVE)
        until(lambda: page.frames)
        assert settable_exposure(page.rigs[0].camera) is None
        white = page.frames[-1].image.mean()
        worker.change(picture=IdlePicture.BLACK)
        until(lambda: page.frames[-1].image.mean() < white / 2)
    finally:
        status = worker.close()
    assert status.message == ""
