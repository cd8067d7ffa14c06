"""PNG files written in strips are read by other libraries."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from scanner.io.image_damage import damage
from scanner.io.png import png_of


def noise(shape: tuple[int, ...], kind: type) -> np.ndarray:
    return np.random.default_rng(5).integers(0, np.iinfo(kind).max + 1, shape).astype(kind)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (3, 1), (7, 5), (1201, 997), (640, 611, 3), (5, 4, 4)])
def test_opencv_and_pillow_read_what_was_written(shape: tuple[int, ...], kind: type) -> None:
    image = noise(shape, kind)
    data = png_of(image)
    assert damage(data) is None
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(found, image)
    if kind is np.uint8 and len(shape) == 2:  # Pillow has no other 16 bits, and another order of colours
        np.testing.assert_array_equal(np.asarray(Pillow.open(io.BytesIO(data))), image)


def test_a_strided_view_is_written() -> None:
    image = noise((900, 1400), np.uint16)[::2, 1::2]
    found = cv2.imdecode(np.frombuffer(png_of(image), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(found, image)


def test_the_size_of_a_noisy_frame_is_near_its_entropy() -> None:
    """Noise of two levels has an entropy of log2(2 √(2 π e)) = 3.0 bits, and √2 times the deviation in differences."""
    levels = np.random.default_rng(2).normal(100, 2, (1024, 1224)).clip(0, 255)
    image = np.rint(levels).astype(np.uint8)
    bits = 8 * len(png_of(image)) / image.size
    assert 3.0 < bits < 3.7


@pytest.mark.parametrize(
    "image", [np.zeros((4, 4), np.float32), np.zeros((4, 4, 2), np.uint8), np.zeros((0, 4), np.uint8)]
)
def test_an_array_that_is_no_image_is_refused(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="cannot be written as PNG"):
        png_of(image)
