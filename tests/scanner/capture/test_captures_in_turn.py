"""`scan --captures N`: how the rig is moved, who is asked, and what remains after a device failure."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hw.errors import DeviceError
from hw.open_rig import OpenedRig, at_place
from hw.rig import Capabilities, Frame, Rig
from hw.settings import SimulatedRigSettings
from scanner import acquisition
from scanner.capture import rig_placement as places
from scanner.capture.recording import open_capture
from scanner.commands import main
from scanner.configuration import load_config
from scanner.decoding import SMOOTH_PX
from scanner.errors import InputError
from scanner.reconstruction import read_captures
from scanner.ui import Terminal
from tests.support.small_capture import SIZE

BEFORE_PATTERNS = 5  # frames, of lines of one pixel and what they are compared with
CONFIG = """
camera: {width: 48, height: 32}
projector: {width: 48, height: 32}
rig: {backend: simulated, pose: 1}
sequence: {preset: quick}
"""


class Operator(Terminal):
    """A quiet terminal with predefined answers."""

    def __init__(self, *answers: str) -> None:
        super().__init__(quiet=True)
        self.answers = list(answers)
        self.questions: list[str] = []

    @property
    def can_ask(self) -> bool:
        return bool(self.answers)

    def ask(self, question: str) -> str:
        self.questions.append(question)
        return self.answers.pop(0)


class Mirror:
    """A projector and camera in one, which fails after its frames are used up."""

    size = SIZE
    highest_level = 255
    capabilities = Capabilities()

    def __init__(self, frames: int) -> None:
        self.frames = frames
        self._shown = np.zeros(SIZE[::-1], np.uint8)

    def show(self, image: np.ndarray) -> None:
        self._shown = image

    def grab(self) -> Frame:
        self.frames -= 1
        if self.frames < 0:
            raise DeviceError("the camera was unplugged")
        return Frame(self._shown // 2 + 20)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[SimulatedRigSettings]:
    """The settings of opened rigs; the second rig fails after three frames of its patterns."""
    settings_seen: list[SimulatedRigSettings] = []

    @contextmanager
    def open_mirror(settings: SimulatedRigSettings, *_: object) -> Iterator[OpenedRig]:
        settings_seen.append(settings)
        mirror = Mirror(BEFORE_PATTERNS + 3 if len(settings_seen) == 2 else 1000)
        yield OpenedRig(Rig(mirror, mirror), None)

    monkeypatch.setattr(acquisition, "open_rig", open_mirror)
    return settings_seen


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(CONFIG)
    return path


def test_a_device_failure_keeps_the_captured_frames(
    tmp_path: Path, config: Path, opened: list[SimulatedRigSettings], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "room"
    assert main(["--config", str(config), "--captures", "3", "--out", str(out), "--quiet"]) == 3
    assert [settings.pose for settings in opened] == [1, 2]
    kept = tmp_path / "room-incomplete"
    message = capsys.readouterr().err
    for words in ("unplugged", f"1 complete capture in {kept / 'captures'}", f"3 frames in {kept / 'capture'}"):
        assert words in message
    assert not out.exists()
    whole, part = open_capture(kept / "captures/1/capture"), open_capture(kept / "capture")
    assert len(whole.patterns) == len(load_config(config).sequence.patterns(SIZE))
    assert part.patterns == whole.patterns[:3]
    (found,) = read_captures([kept], SIZE, SIZE)  # as scan calibrate does
    assert found.name == str(kept / "captures/1")
    assert len(found.matches) > 0.5 * SIZE[0] * SIZE[1]
    # Its matches are no surer than they were when they were decoded: 'quick' errs more than usual fringes do.
    decoded = acquisition.decode_recording(whole, Operator())
    assert 3 * SMOOTH_PX < found.origin.smooth_px == decoded.origin.smooth_px < 4 * SMOOTH_PX


@pytest.fixture
def unmoved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rigs that a person has to move."""
    monkeypatch.setattr(places, "moves_by_itself", lambda settings: False)


@pytest.mark.usefixtures("unmoved")
def test_the_operator_is_asked_between_captures_and_may_stop(
    tmp_path: Path, config: Path, opened: list[SimulatedRigSettings], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened.extend([SimulatedRigSettings()] * 2)  # so that none of those to come breaks
    operator = Operator("", "q")
    taken = acquisition.take_captures(load_config(config), tmp_path, 4, (), operator, operator)
    assert len(operator.questions) == 2
    assert "Capture 2 of 4 is done" in operator.questions[1]
    assert [found.name for found in taken] == ["Capture 1", "Capture 2"]
    assert (tmp_path / "capture/capture.yaml").exists()
    assert (tmp_path / "captures/1/capture/capture.yaml").exists()
    assert not (tmp_path / "captures/2").exists()


@pytest.mark.usefixtures("unmoved")
def test_without_a_terminal_several_captures_are_refused(
    tmp_path: Path, config: Path, opened: list[SimulatedRigSettings], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--config", str(config), "--captures", "2", "--out", str(tmp_path / "room")]) == 2
    message = capsys.readouterr().err
    assert "--captures 2 asks you to move the rig" in message
    assert "scan calibrate" in message
    assert opened == []
    places.check_places(SimulatedRigSettings(), 2, Operator("yes"))
    with pytest.raises(InputError):
        places.check_places(SimulatedRigSettings(), 2, Operator())


def test_the_end_of_the_input_stops_the_captures(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def end() -> str:
        raise EOFError

    monkeypatch.setattr("builtins.input", end)
    assert Terminal(quiet=True).ask("Go on [y/n]? ") == "q"
    assert capsys.readouterr() == ("", "Go on [y/n]? ")


def test_a_simulated_rig_moves_by_itself() -> None:
    settings = SimulatedRigSettings(seed=4, pose=2)
    assert at_place(settings, 0) == settings
    assert at_place(settings, 3) == settings.model_copy(update={"pose": 5})
    assert at_place(settings, 5) == settings.model_copy(update={"pose": 7})
    with pytest.raises(DeviceError, match=r"poses 0 to 7; from pose 2 it cannot move 6 times"):
        at_place(settings, 6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--captures", "0"), "--captures: expected 1 or more, found 0"),
        (("--captures", "two"), "--captures"),
        (("--captures", "2", "--masks", "."), "--masks are of one view"),
        (("--captures", "2", "--set", "method=paper"), "'method: paper'"),
        (("--captures", "9"), "cannot move 8 times"),
        (("--set", "earlier=[nowhere]"), "nowhere: no such matches file"),
        (("--set", "earlier=nowhere"), "'earlier'"),
    ],
)
def test_everything_is_checked_before_the_first_capture(
    tmp_path: Path,
    config: Path,
    opened: list[SimulatedRigSettings],
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: str,
) -> None:
    assert main(["--config", str(config), "--out", str(tmp_path / "room"), *arguments]) == 2
    assert words in capsys.readouterr().err
    assert opened == []
    assert [path.name for path in tmp_path.iterdir()] == ["room.yaml"]
