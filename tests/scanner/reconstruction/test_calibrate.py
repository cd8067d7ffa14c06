"""Faces lose the margin where a blurred lens mixes them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import NO_FACE, Matches, Size
from scanner.errors import InputError
from scanner.io import write_png
from scanner.reconstruction.calibrate import label_by_masks, read_masks, without_margins

SIZE = Size(40, 30)
SIZE_OF_WALLS = (80, 60)


def draw_mask(folder: Path, name: str, columns: slice, shape: tuple[int, ...] = (30, 40), value: int = 255) -> None:
    mask = np.zeros(shape, np.uint8)
    mask[:, columns] = value
    write_png(folder / name, mask)


@pytest.fixture
def masks(tmp_path: Path) -> Path:
    draw_mask(tmp_path, "c_floor.png", slice(0, 10))
    draw_mask(tmp_path, "a_left.PNG", slice(10, 20), value=1)
    draw_mask(tmp_path, "b_right.png", slice(20, 30), shape=(30, 40, 3))
    return tmp_path


def test_faces_are_numbered_in_the_order_of_the_file_names(masks: Path) -> None:
    (masks / "notes.txt").touch()
    (masks / ".hidden.png").touch()
    camera_px = np.array([[5.0, 7], [15, 0], [25, 29], [35, 7], [9.6, 1], [-3, 5], [15, 400]])
    matches = label_by_masks(Matches(camera_px, camera_px), read_masks(masks, SIZE))
    assert matches.face is not None
    assert matches.face.tolist() == [2, 0, 1, -1, 0, -1, -1]


def remove(folder: Path) -> None:
    (folder / "a_left.PNG").unlink()


WRONG: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "two": (remove, ("three PNG", "found 2", "b_right.png, c_floor.png")),
    "four": (lambda folder: draw_mask(folder, "d.png", slice(35, 40)), ("three PNG", "found 4")),
    "overlap": (
        lambda folder: draw_mask(folder, "a_left.PNG", slice(15, 25)),
        ("a_left.PNG and b_right.png overlap in 150 pixels",),
    ),
    "another size": (
        lambda folder: draw_mask(folder, "a_left.PNG", slice(15, 25), shape=(30, 60)),
        ("a_left.PNG", "40 × 30", "60 × 30"),
    ),
    "empty": (lambda folder: draw_mask(folder, "a_left.PNG", slice(0, 0)), ("a_left.PNG", "every pixel is zero")),
    "no image": (lambda folder: (folder / "a_left.PNG").write_text("hello"), ("a_left.PNG", "decoded")),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_masks_are_refused(masks: Path, name: str) -> None:
    break_it, words = WRONG[name]
    break_it(masks)
    with pytest.raises(InputError) as caught:
        read_masks(masks, SIZE)
    for word in words:
        assert word in str(caught.value)


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder of masks"):
        read_masks(tmp_path / "masks", SIZE)


def halves() -> Matches:
    """Two faces side by side that meet at column 40; one of them has a pixel without a match."""
    row, column = np.divmod(np.arange(SIZE_OF_WALLS[0] * SIZE_OF_WALLS[1]), SIZE_OF_WALLS[0])
    there = ~((row == 30) & (column == 20))
    pixels = np.stack([column, row], axis=1)[there].astype(np.float64)
    return Matches(pixels, pixels).with_faces((pixels[:, 0] >= 40).astype(np.int32))


def test_with_a_sharp_lens_faces_keep_their_margins() -> None:
    matches = halves()
    assert without_margins(matches, SIZE_OF_WALLS, 0.0) is matches
    assert without_margins(matches, SIZE_OF_WALLS, 0.9) is matches


def test_matches_within_two_blur_sigmas_of_the_border_lose_their_face() -> None:
    found = without_margins(halves(), SIZE_OF_WALLS, 4.0)
    assert found.face is not None
    column, row = found.camera_px.T
    near = np.abs(column - 39.5) < 4
    assert np.all(found.face[near] == NO_FACE)
    inner = (np.abs(column - 39.5) > 5) & (np.minimum(column, 79 - column) > 5) & (np.minimum(row, 59 - row) > 5)
    np.testing.assert_array_equal(found.face[inner], column[inner] >= 40)
