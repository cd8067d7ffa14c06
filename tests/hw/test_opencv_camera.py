"""Failures of OpenCV capture are named. The capture here is a fake; the loopback tests use a real one."""

import os
import signal
import sys
import time
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread, main_thread
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from hw import opencv
from hw.errors import DeviceError
from hw.opencv import OpenCVCamera, OpenCVRigSettings
from hw.timing import frame_reader

SIZE = (32, 24)


class Capture:
    """OpenCV's interface: delivers `frames` in order, every 5 ms, then nothing."""

    def __init__(
        self, *frames: np.ndarray, obeys: bool = True, opens: bool = True, fixed: Collection[int] = ()
    ) -> None:
        self._fixed = fixed
        self._frames, self._obeys, self._opens = [*frames], obeys, opens
        self._values: dict[int, float] = {}
        self.released = False

    def isOpened(self) -> bool:  # noqa: N802
        return self._opens

    def getBackendName(self) -> str:  # noqa: N802
        return "FAKE"

    def set(self, key: int, value: float) -> bool:
        if not self._obeys or key in self._fixed:
            return False
        self._values[key] = value
        return True

    def get(self, key: int) -> float:
        return self._values.get(key, 0.5)

    def read(self) -> tuple[bool, np.ndarray | None]:
        time.sleep(0.005)
        return (True, self._frames.pop(0)) if self._frames else (False, None)

    def release(self) -> None:
        self.released = True


def picture(level: int = 90, size: tuple[int, int] = SIZE, channels: tuple[int, ...] = (3,)) -> np.ndarray:
    return np.full((size[1], size[0], *channels), level, np.uint8)


def connected(monkeypatch: pytest.MonkeyPatch, capture: Capture, **settings: Any) -> OpenCVCamera:
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: capture)
    return opencv.connect(OpenCVRigSettings(backend="opencv", **settings), SIZE, 60.0)


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (picture(size=SIZE[::-1]), r"expected frames of 32 × 24, but it delivers 24 × 32.*camera: \{width: 24"),
        (picture(channels=(2,)), "three channels.*delivers 2 channels"),
        (picture().astype(np.uint16), "uint16"),
    ],
    ids=["size", "channels", "depth"],
)
@pytest.mark.parametrize("amid", [False, True])
def test_unexpected_frames_are_named(
    monkeypatch: pytest.MonkeyPatch, frame: np.ndarray, words: str, amid: bool
) -> None:
    capture = Capture(*([picture(1), picture(2)] if amid else []), frame)
    with pytest.raises(DeviceError, match=words), connected(monkeypatch, capture) as camera:
        camera.reader.following(5)
    assert capture.released


def test_frames_that_lose_their_colours_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = Capture(picture(1), picture(2), picture(3, channels=()))
    with pytest.raises(DeviceError, match="delivers grey"), connected(monkeypatch, capture) as camera:
        camera.reader.following(5)


def test_an_absent_or_silent_camera_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DeviceError, match=r"webcam 0: OpenCV cannot open it.*scan devices"):
        connected(monkeypatch, Capture(opens=False))
    with pytest.raises(DeviceError, match="delivers no frames"):
        connected(monkeypatch, Capture())
    capture = Capture(picture(1), picture(2))
    with pytest.raises(DeviceError, match="stream has ended"), connected(monkeypatch, capture) as camera:
        camera.reader.following(5)


@pytest.mark.parametrize(
    ("camera", "attempts"),
    [
        ("rtsp://127.0.0.1:9/video", 1),
        ("rtspsrc location=rtsp://127.0.0.1:9/video ! decodebin ! appsink", 2),
    ],
)
def test_only_a_pipeline_is_opened_without_a_time_limit(
    monkeypatch: pytest.MonkeyPatch, camera: str, attempts: int
) -> None:
    calls = list[tuple[Any, ...]]()

    def open_capture(*arguments: object) -> Capture:
        calls.append(arguments)
        return Capture(opens=False)

    monkeypatch.setattr(cv2, "VideoCapture", open_capture)
    with pytest.raises(DeviceError, match="OpenCV cannot open it"):
        opencv.connect(OpenCVRigSettings(backend="opencv", camera=camera), SIZE, 60.0)
    assert len(calls) == attempts
    assert cv2.CAP_PROP_OPEN_TIMEOUT_MSEC in calls[0][2]
    assert cv2.CAP_PROP_READ_TIMEOUT_MSEC in calls[0][2]


@pytest.mark.parametrize("while_reading", [False, True])
def test_an_interruption_does_not_wait_for_a_silent_camera(
    monkeypatch: pytest.MonkeyPatch, while_reading: bool
) -> None:
    begun, may_end = Event(), Event()

    def silent() -> None:
        begun.set()
        Thread(target=lambda: signal.pthread_kill(main_thread().ident, signal.SIGINT)).start()
        assert may_end.wait(60)

    class Silent(Capture):
        def read(self) -> tuple[bool, np.ndarray | None]:
            silent()
            return False, None

    def open_capture(*_: object) -> Capture:
        if not while_reading:
            silent()
        return Silent()

    monkeypatch.setattr(cv2, "VideoCapture", open_capture)
    with pytest.raises(KeyboardInterrupt):
        opencv.connect(OpenCVRigSettings(backend="opencv", camera="rtsp://phone/video"), SIZE, 60.0)
    assert begun.is_set()
    assert not may_end.is_set()
    may_end.set()


def test_a_stream_that_stops_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_reader, "_NOTHING_S", 0.2)

    def read() -> tuple[np.ndarray, None]:
        time.sleep(0.5)
        return picture(), None

    reader = frame_reader.FrameReader("phone", read, lambda: None)
    with pytest.raises(DeviceError, match="camera phone: no frame for"):
        reader.following(-1)
    reader.close()


def test_repeated_and_dropped_frames_are_counted() -> None:
    moments = iter([0.002 * number + (0.02 if number >= 100 else 0.0) for number in range(140)])
    begin_s = time.monotonic()
    levels = iter([number - (number == 120) for number in range(140)])

    def read() -> tuple[np.ndarray, None] | None:
        moment = next(moments, None)
        if moment is None:
            return None
        time.sleep(max(0.0, begin_s + 5 * moment - time.monotonic()))
        return picture(next(levels)), None

    reader = frame_reader.FrameReader("webcam", read, lambda: None)
    seen, number = list[int](), -1
    with suppress(DeviceError):  # the stream has ended
        while True:
            arrival = reader.following(number)
            number = arrival.number
            seen.append(int(arrival.image[0, 0, 0]))
    reader.close()
    assert len(seen) > 30
    assert seen == sorted(set(seen))
    assert reader.repeated == 1
    assert 5 <= reader.dropped <= 20  # ten frames' time without one


def test_an_exposure_that_cannot_be_changed_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    for fixed, expected in ((set[int](), "settable"), ({cv2.CAP_PROP_EXPOSURE}, "readable")):
        capture = Capture(*map(picture, range(3)), fixed=fixed)
        with connected(monkeypatch, capture) as camera:
            assert camera.capabilities.exposure == expected
            assert camera.exposure_us == 50


@pytest.mark.parametrize("obeys", [True, False])
def test_automatics_are_turned_off_where_the_driver_can(monkeypatch: pytest.MonkeyPatch, obeys: bool) -> None:
    capture = Capture(*map(picture, range(3)), obeys=obeys)
    if not obeys:
        with connected(monkeypatch, capture) as camera:
            assert camera.capabilities.exposure == "unknown"
            assert camera.identity["automatic exposure"] == "not in the driver's hand"
        with pytest.raises(DeviceError, match=r"exposure in µs was set to 33333.3, but reads back as 50.*tool or app"):
            connected(monkeypatch, Capture(picture(), obeys=False), exposure_us=33_000)
        return
    with connected(monkeypatch, capture, exposure_us=33_000) as camera:
        assert camera.exposure_us == pytest.approx(2e6 / 60)
        assert camera.capabilities.exposure == "settable"
        assert camera.identity["automatic exposure"] == "off"


@pytest.mark.parametrize("key", ["exposure_us", "gain", "codec"])
def test_settings_that_a_stream_cannot_take_are_refused(key: str) -> None:
    value = "MJPG" if key == "codec" else 10.0
    assert OpenCVRigSettings(backend="opencv", camera=0, **{key: value}).has_gain
    with pytest.raises(ValidationError, match=f"{key}: cannot be set for a stream"):
        OpenCVRigSettings(backend="opencv", camera="http://phone/video", **{key: value})


def test_a_gain_that_a_driver_ignores_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DeviceError, match=r"gain was set to 3, but reads back as 0.5"):
        connected(monkeypatch, Capture(picture(), fixed={cv2.CAP_PROP_GAIN}), gain=3.0)


def test_webcams_are_listed_with_lines_to_paste_or_the_obstacle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in (0, 2):
        (tmp_path / f"video{number}").mkdir()
        (tmp_path / f"video{number}" / "name").write_text("USB camera\n")
    monkeypatch.setattr(opencv, "_V4L", tmp_path)
    monkeypatch.setattr(opencv, "_DEVICES", tmp_path)
    monkeypatch.setattr(os, "access", lambda path, _: path.name != "video2")
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: Capture())
    first, second = opencv.list_cameras()
    assert first.name == "webcam 0 (USB camera)"
    assert first.rig == ("backend: opencv", "camera: 0")
    assert second.rig == ()
    assert f"belongs to group {tmp_path.group()}" in second.about
