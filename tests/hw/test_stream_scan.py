"""Whole scans with a network camera, through OpenCV's own capture: what can go wrong with it amid a scan is named,
nothing is lost, and what is missing is taken when it is there again.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest

from hw import open_rig
from hw.settings import SimulatedRigSettings
from hw.simulated.simulation import SimulatedRoom
from hw.timing import frame_reader, stream_calibration
from scanner import pipeline
from scanner.capture.recording import open_capture
from scanner.commands import scan as scan_command
from scanner.commands.main import main
from tests.support.phone import Phone
from tests.support.simulated_window import SimulatedWindow

SIZE, PROJECTOR = (160, 120), (160, 96)
BEFORE = 7  # pictures that are shown before the capture's own, or are its first


@pytest.fixture(scope="module")
def room() -> SimulatedRoom:
    return SimulatedRoom(SimulatedRigSettings(seed=0), SIZE, PROJECTOR)


@pytest.fixture
def phone(monkeypatch: pytest.MonkeyPatch, room: SimulatedRoom) -> Iterator[Phone]:
    """A phone that sees the light of the window; what nobody would wait for in a test is waited for shortly."""
    with Phone(room) as phone:

        @contextmanager
        def window(*_: object) -> Iterator[SimulatedWindow]:
            yield SimulatedWindow(PROJECTOR, phone.light)

        phone.light(np.zeros(PROJECTOR[::-1], np.uint8))
        monkeypatch.setattr(open_rig, "ScreenProjector", window)
        monkeypatch.setattr(stream_calibration, "_LONGEST_LATENCY_S", 0.3)
        monkeypatch.setattr(stream_calibration, "_WATCHED_S", 0.5)
        monkeypatch.setattr(frame_reader, "_NOTHING_S", 0.8)
        monkeypatch.setattr(pipeline, "reconstruct", lambda found, *_, **__: found)
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


def later(phone: Phone, change: Callable[[np.ndarray], np.ndarray | None]) -> Callable[[np.ndarray], np.ndarray | None]:
    """The change, from the capture's 14th picture on."""
    return lambda image: change(image) if phone.shown > BEFORE + 14 else image


def repeated() -> Callable[[np.ndarray], np.ndarray]:
    kept: list[np.ndarray] = []

    def frozen(image: np.ndarray) -> np.ndarray:
        kept[:] = kept or [image]
        return kept[0]

    return frozen


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda image: cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE), "sees another picture than when the capture began"),
        (lambda _: None, "no frame for 1 s"),
        (repeated(), "its picture is frozen"),
    ],
    ids=["rotated", "silent", "frozen"],
)
def test_what_goes_wrong_amid_a_scan_is_named_and_the_rest_is_taken(
    monkeypatch: pytest.MonkeyPatch,
    config: Path,
    phone: Phone,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[np.ndarray], np.ndarray | None],
    words: str,
) -> None:
    phone.changed = later(phone, change)
    code, capture = scan(config)
    assert code == 3
    message = " ".join(capsys.readouterr().err.split())
    assert words in message
    assert phone.address in message
    taken = len(open_capture(capture).patterns)
    assert taken >= 3
    phone.changed = lambda image: image
    assert main(["--resume", str(capture.parent), "--out", str(config.with_name("whole")), "--quiet"]) == 0
    recording = open_capture(config.with_name("whole") / "capture")
    assert recording.metadata["resumed"]["after_frames"] == taken
    assert len(recording.patterns) >= len(recording.planned)
