"""An interrupted capture, and rigs that may or may not resume it."""

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from hw.open_rig import open_rig
from hw.rig import Capabilities, Frame, Rig, exposure_control
from hw.settings import SimulatedRigSettings
from scanner.capture.recorder import record
from scanner.capture.recording import Recording, open_capture
from scanner.capture.resuming import take_up
from scanner.capture.stream import capture
from scanner.decoding import Decoder
from scanner.errors import InputError
from scanner.patterns import PRESETS, Black, Gray, Pattern, Phase, White

SIZE = (120, 80)
PATTERNS = PRESETS["quick"].patterns(SIZE)
# In the middle of the fringes: two steps along x, one along y.
TAKEN = next(n for n, pattern in enumerate(PATTERNS) if isinstance(pattern, Phase)) + 3


@dataclass
class Wall:
    """A projector and a camera that sees its picture, with a given brightness and shift."""

    size: tuple[int, int] = SIZE
    highest_level: int = 255
    capabilities: ClassVar[Capabilities] = Capabilities(exposure="settable")
    gain: float = 1.0
    moved_px: int = 0
    exposure_us: float = 10_000.0
    exposure_limits_us: tuple[float, float] = (1.0, 1e6)
    name: str = "a camera"

    def __post_init__(self) -> None:
        self._shown = np.zeros(SIZE[::-1], np.uint8)
        self._noise = np.random.default_rng(0)

    def show(self, image: np.ndarray) -> None:
        self._shown = np.roll(image, -self.moved_px, axis=1)

    def expose_for(self, exposure_us: float) -> float:
        self.exposure_us = exposure_us
        return exposure_us

    def grab(self) -> Frame:
        level = self.gain * self.exposure_us / 10_000 * (10 + 0.4 * self._shown) + self._noise.normal(
            0, 0.7, SIZE[::-1]
        )
        return Frame(np.rint(level).clip(0, 255).astype(np.uint8), self.exposure_us)

    def rig(self) -> Rig:
        return Rig(self, self, {"camera": self.name})


def broken_off(folder: Path, count: int, exposures_us: tuple[float, ...] = ()) -> Recording:
    """A recording that ends after a number of frames."""
    live = record(capture(Wall().rig(), PATTERNS, exposures_us), folder)
    assert len(list(islice(live.frames, count))) == count
    return open_capture(folder)


@pytest.fixture
def begun(tmp_path: Path) -> Recording:
    return broken_off(tmp_path / "begun", TAKEN)


def taken_up(begun: Recording, folder: Path, wall: Wall, exposures_us: tuple[float, ...] = ()) -> Recording:
    list(record(take_up(begun, wall.rig(), PATTERNS, exposures_us), folder).frames)
    return open_capture(folder)


def matches_in(recording: Recording) -> int:
    decoder = Decoder(recording.patterns, recording.projector_size)
    for _, frame in recording.stream().frames:
        decoder.add(frame.image, frame.exposure_us)
    return len(decoder.finish().matches)


def test_only_missing_frames_are_taken(begun: Recording, tmp_path: Path) -> None:
    found = taken_up(begun, tmp_path / "whole", Wall())
    witnesses = found.patterns[TAKEN : len(found.patterns) - len(PATTERNS) + TAKEN]
    assert found.patterns[:TAKEN] == PATTERNS[:TAKEN]
    assert found.patterns[TAKEN + len(witnesses) :] == PATTERNS[TAKEN:]
    assert witnesses == (White(), Gray("x", 3, 4, 8), PATTERNS[TAKEN - 2], Gray("y", 3, 4, 8), PATTERNS[TAKEN - 1])
    assert found.metadata["resumed"]["after_frames"] == TAKEN
    for before, after in zip(begun.stream().frames, islice(found.stream().frames, TAKEN), strict=True):
        np.testing.assert_array_equal(before[1].image, after[1].image)
        assert before[1].exposure_us == after[1].exposure_us
    assert 0.9 < matches_in(found) / (SIZE[0] * SIZE[1]) <= 1
    with pytest.raises(InputError, match="nothing is missing; scan replay"):
        taken_up(found, tmp_path / "again", Wall())


def test_a_resumed_capture_may_be_interrupted_again(begun: Recording, tmp_path: Path) -> None:
    live = record(take_up(begun, Wall().rig(), PATTERNS), tmp_path / "second")
    list(islice(live.frames, TAKEN + 6))  # with a frame behind the five witnesses
    found = taken_up(open_capture(tmp_path / "second"), tmp_path / "third", Wall())
    assert tuple(dict.fromkeys(found.patterns)) == PATTERNS
    assert matches_in(found) > 1000


@pytest.mark.parametrize(
    ("wall", "words"),
    [
        (Wall(moved_px=1), r"shown again, and it is shifted by .* camera px"),
        (Wall(moved_px=13), "cannot be resumed"),
        (Wall(gain=0.6), r"frame 0 \(frames/000.png\) was shown again, and it is 0.60 times as bright"),
        (Wall(name="a new one"), r"with other settings: camera: a camera then, a new one now"),
    ],
)
def test_a_different_rig_or_scene_is_refused(begun: Recording, tmp_path: Path, wall: Wall, words: str) -> None:
    with pytest.raises(InputError, match=words):
        taken_up(begun, tmp_path / "whole", wall)
    assert not (tmp_path / "whole").exists()


def test_incomplete_exposures_of_a_pattern_are_retaken(tmp_path: Path) -> None:
    exposures_us = (5000.0, 20000.0)
    begun = broken_off(tmp_path / "begun", 7, exposures_us)
    found = taken_up(begun, tmp_path / "whole", Wall(), exposures_us)
    assert found.patterns[:6] == begun.patterns[:6]
    assert found.patterns[6:8] == (White(), White())
    assert [found.read_back[n][0] for n in range(6, 10)] == [5000.0, 20000.0, 5000.0, 20000.0]
    assert matches_in(found) > 1000


def test_the_sequence_must_match_the_recording(begun: Recording) -> None:
    silent = replace(begun, planned=())  # of another version
    first: Pattern = Black()
    with pytest.raises(InputError, match="are not the first of the configured sequence"):
        take_up(replace(silent, patterns=(first, *begun.patterns[1:])), Wall().rig(), PATTERNS)
    assert tuple(dict.fromkeys(take_up(silent, Wall().rig(), PATTERNS).patterns)) == PATTERNS


def test_a_simulated_rig_resumes(tmp_path: Path) -> None:
    camera, projector = (306, 256), (214, 120)
    room = SimulatedRigSettings.model_validate({"seed": 0, "furniture": False, "interreflection": False})
    patterns = PRESETS["quick"].patterns(projector)
    with open_rig(room, camera, projector) as opened:
        live = record(capture(opened.rig, patterns), tmp_path / "begun")
        list(islice(live.frames, 15))
        rest = take_up(open_capture(tmp_path / "begun"), opened.rig, patterns)
        list(record(rest, tmp_path / "whole").frames)
        exposure_control(opened.rig.camera).expose_for(2e4)
        with pytest.raises(InputError, match="times as bright"):
            take_up(open_capture(tmp_path / "begun"), opened.rig, patterns)
    assert 0.1 < matches_in(open_capture(tmp_path / "whole")) / (camera[0] * camera[1]) < 0.9
