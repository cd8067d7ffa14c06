"""PNG files, read by another library."""

import cv2
import numpy as np
import pytest

from scanner.rendering.colours import IndexedPicture, Pixels, png_of


def read_back(data: bytes) -> Pixels:
    """RGBA (H, W, 4)."""
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGRA2RGBA), np.uint8)


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (64, 100)])
def test_rgba_is_read_back_the_same(shape: tuple[int, int]) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (*shape, 4), dtype=np.uint8)
    assert np.array_equal(read_back(png_of(picture)), picture)


@pytest.mark.parametrize("colours", [1, 25, 256])
def test_a_palette_is_read_back_as_its_colours(colours: int) -> None:
    rng = np.random.default_rng(colours)
    palette = rng.integers(0, 256, (colours, 4), dtype=np.uint8)
    palette[0, 3] = 0  # a decoder may leave out an opacity that is full everywhere
    picture = IndexedPicture(rng.integers(0, colours, (40, 30)).astype(np.uint8), palette)
    written_out = palette[picture.index]
    assert np.array_equal(read_back(png_of(picture)), written_out)
    assert len(png_of(picture)) < len(png_of(written_out))
