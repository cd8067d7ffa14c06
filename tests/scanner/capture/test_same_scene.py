"""Two frames of one pattern: changes are measured, and irrelevant ones tolerated."""

import cv2
import numpy as np
import pytest

from hw.open_rig import open_rig
from hw.settings import SimulatedRigSettings
from scanner.capture.resuming import compare, refuse_another_scene, scale_of
from scanner.errors import InputError
from scanner.patterns import Gray, White, draw

pytestmark = pytest.mark.xdist_group("same scene")  # what the module shares is made once

CAMERA, PROJECTOR = (306, 256), (214, 120)
PATTERNS = (White(), Gray("x", 4, 5, 8), Gray("y", 3, 4, 8))


def frames(skip: int = 2, **settings: object) -> list[np.ndarray]:
    """White, and the finest stripes along x and y; the noise depends on the number of frames before."""
    room = {"seed": 0, "furniture": False, "interreflection": False}
    with open_rig(SimulatedRigSettings.model_validate(room | settings), CAMERA, PROJECTOR) as opened:
        for _ in range(skip):
            opened.rig.camera.grab()
        pictures = [draw(pattern, PROJECTOR) for pattern in PATTERNS]
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
