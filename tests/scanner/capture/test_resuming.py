"""An interrupted capture, and rigs that may or may not resume it.

Two frames of one pattern: changes are measured, and irrelevant ones tolerated.
"""

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
import pytest

from hw.open_rig import open_rig
from hw.rig import Capabilities, Frame, Rig, exposure_control
from hw.settings import SimulatedRigSettings
from scanner.capture.recorder import record
from scanner.capture.recording import Recording, open_capture
from scanner.capture.resuming import compare, refuse_another_scene, scale_of, take_up
from scanner.capture.stream import capture
from scanner.decoding import Decoder
from scanner.errors import InputError
from scanner.patterns import PRESETS, Black, Gray, Pattern, Phase, White, draw

pytestmark = pytest.mark.xdist_group("same scene")  # what the module shares is made once

CAMERA, PROJECTOR = (306, 256), (214, 120)
PATTERNS_OF_SCENE = (White(), Gray("x", 4, 5, 8), Gray("y", 3, 4, 8))
SIZE = (120, 80)
PATTERNS = PRESETS["quick"].patterns(SIZE)
# In the middle of the fringes: two steps along x, one along y.
TAKEN = next(n for n, pattern in enumerate(PATTERNS) if isinstance(pattern, Phase)) + 3


def frames(skip: int = 2, **settings: object) -> list[np.ndarray]:
    """White, and the finest stripes along x and y; the noise depends on the number of frames before."""
    room = {"seed": 0, "furniture": False, "interreflection": False}
    with open_rig(SimulatedRigSettings.model_validate(room | settings), CAMERA, PROJECTOR) as opened:
        for _ in range(skip):
            opened.rig.camera.grab()
        pictures = [draw(pattern, PROJECTOR) for pattern in PATTERNS_OF_SCENE]
        return [frame.image for frame in opened.rig.photograph(pictures)]


@pytest.fixture(scope="module")
def before() -> list[np.ndarray]:
    return frames(skip=0)


@pytest.fixture(scope="module")
def after() -> list[np.ndarray]:
    return frames()


def shifted(image: np.ndarray, px: float) -> np.ndarray:
    """The picture of a camera that was rotated sideways."""
    matrix = np.array([[1.0, 0.0, px], [0.0, 1.0, 0.0]])
    return cv2.warpAffine(image, matrix, image.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def test_at_rest_nothing_differs(before: list[np.ndarray], after: list[np.ndarray]) -> None:
    scale = scale_of(before[0], PROJECTOR)
    assert 0.3 < scale < 1.5
    for one, other in zip(before, after, strict=True):
        found = compare(one, other)
        assert 0.99 < found.gain < 1.01
        assert 0 < found.moved_px < 0.1
        assert found.changed < 0.01
        refuse_another_scene("a pattern", one, other, scale)


@pytest.mark.parametrize("px", [0.3, 0.6, 1.0])
def test_the_cameras_motion_is_measured(before: list[np.ndarray], after: list[np.ndarray], px: float) -> None:
    along_x = compare(before[1], shifted(after[1], px))
    assert 0.7 * px < along_x.moved_px < 1.3 * px
    with pytest.raises(InputError, match=r"frame 2 was shown again, and it is shifted by .* camera px"):
        refuse_another_scene("frame 2", before[1], shifted(after[1], px), scale_of(before[0], PROJECTOR))


@pytest.mark.parametrize("px", [4.0, 12.0, 40.0])
def test_large_motion_is_not_taken_for_small(before: list[np.ndarray], after: list[np.ndarray], px: float) -> None:
    with pytest.raises(InputError, match="cannot be resumed"):
        refuse_another_scene("frame 2", before[1], shifted(after[1], px))


def test_the_projectors_motion_shows_in_the_stripes(before: list[np.ndarray]) -> None:
    moved = frames(bump={"device": "projector", "frame": 0, "px": 1.0})
    scale = scale_of(before[0], PROJECTOR)
    assert 0.8 * scale < compare(before[1], moved[1]).moved_px < 1.3 * scale
    with pytest.raises(InputError, match="projector or scene have moved"):
        refuse_another_scene("frame 1", before[1], moved[1], scale)


def test_specks_of_a_compression_do_not_move(before: list[np.ndarray], after: list[np.ndarray]) -> None:
    """Around a small lit part of a picture that is black, and the same in both frames but for some pixels."""
    rng = np.random.default_rng(0)
    for one, other in zip(before, after, strict=True):
        was, now = (np.where(before[0] > 30, image, 0).astype(np.uint8) for image in (one, other))
        for image in (was, now):
            specks = rng.random(image.shape) < 0.01
            image[specks & (image == 0)] = rng.integers(1, 3)
        assert 0 < compare(was, now).moved_px < 0.05
        refuse_another_scene("frame 3", was, now)


def test_flicker_is_tolerated_and_another_exposure_is_not(before: list[np.ndarray], after: list[np.ndarray]) -> None:
    for one, other in zip(before, after, strict=True):
        refuse_another_scene("frame 3", one, (0.9 * other).astype(np.uint8))
        with pytest.raises(InputError, match=r"frame 3 was shown again, and it is 0\.[56]. times as bright"):
            refuse_another_scene("frame 3", one, (0.6 * other).astype(np.uint8))
        with pytest.raises(InputError, match="light in the room"):
            refuse_another_scene("frame 3", one // 2, other // 2 + 60)


def test_a_new_object_is_detected(before: list[np.ndarray], after: list[np.ndarray]) -> None:
    other = after[0].copy()
    bright = np.argwhere(other > np.percentile(other, 97))
    (top, left), (bottom, right) = bright.min(axis=0), bright.max(axis=0)
    other[top:bottom, left : (left + right) // 2] //= 3
    assert 0.1 < compare(before[0], other).changed < 0.9
    with pytest.raises(InputError, match="cannot be resumed"):
        refuse_another_scene("frame 0", before[0], other)


def test_colour_and_depth_make_no_difference(before: list[np.ndarray]) -> None:
    grey, other = before[1], shifted(before[1], 0.5)
    deep = compare(grey.astype(np.uint16) * 16, other.astype(np.uint16) * 16)
    colour = compare(np.dstack([grey] * 3), np.dstack([other] * 3))
    assert deep.moved_px == pytest.approx(colour.moved_px, abs=0.02)
    assert 0.35 < deep.moved_px < 0.65


@pytest.mark.parametrize("channels", [1, 3])
def test_the_scale_is_told_by_what_white_lights(channels: int) -> None:
    """A wall straight on, one at a slant, and what only indirect light reaches, above much light of the room."""
    image = np.full((300, 400), 60, np.uint8)
    image[50:150, 100:300] = 200
    image[150:250, 100:300] = 110
    image[:50, 100:300] = 80
    frame = image if channels == 1 else np.stack([image] * 3, axis=-1)
    assert scale_of(frame, (100, 100)) == pytest.approx(2.0, rel=1e-3)
    assert scale_of(frame, (400, 100)) == pytest.approx(1.0, rel=1e-3)


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
