"""Frames for display: clipping, brightness, and the reduced picture."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scanner.console.picture import CLIPPED_COLOUR, HISTOGRAM_BINS, clipped_pixels, exposed, histogram, sharpness, shown


def grey(height: int = 40, width: int = 60, level: int = 100) -> np.ndarray:
    return np.full((height, width), level, np.uint8)


def test_clipped_pixels_of_8_bits_and_of_12_in_16() -> None:
    image = grey()
    image[3, 4], image[5, 6] = 255, 250
    assert list(zip(*np.nonzero(clipped_pixels(image, 255)), strict=True)) == [(3, 4)]
    deep = np.full((8, 8), 4000, np.uint16)
    deep[1, 2] = 4095
    assert list(zip(*np.nonzero(clipped_pixels(deep, 4095)), strict=True)) == [(1, 2)]


def test_one_clipped_channel_is_enough() -> None:
    image = np.full((4, 4, 3), 50, np.uint8)
    image[2, 1, 0] = 255
    assert clipped_pixels(image, 255).sum() == 1


def test_the_exposure_is_judged() -> None:
    image = grey(10, 10, 51)
    image[:1], image[-2:] = 255, 0
    found = exposed(image, 255)
    assert found.clipped == pytest.approx(0.1)
    assert found.dark == pytest.approx(0.2)
    assert found.median == pytest.approx(0.2)


@given(arrays(np.uint8, (12, 17)))
def test_a_histogram_counts_every_pixel_once(image: np.ndarray) -> None:
    levels, counts = histogram(image, 255)
    assert len(levels) == len(counts) == HISTOGRAM_BINS
    assert counts.sum() == image.size
    assert np.sum(levels * counts) / image.size == pytest.approx(100 * (image.mean() + 0.5) / 256, abs=100 / 128)


def test_the_reduced_picture_keeps_a_single_clipped_pixel() -> None:
    image = grey(1024, 1224)
    image[700, 801] = 255
    marked = shown(image, 255, mark_clipped=True)
    assert max(marked.shape) == 720
    assert np.all(marked == CLIPPED_COLOUR, axis=2).sum() in (1, 2, 3, 4)
    assert not np.any(np.all(shown(image, 255, mark_clipped=False) == CLIPPED_COLOUR, axis=2))


@given(st.integers(0, 4095))
def test_brightness_is_a_share_of_the_range(level: int) -> None:
    picture = shown(np.full((6, 8), level, np.uint16), 4095, mark_clipped=False)
    assert picture.shape == (6, 8, 3)
    assert abs(int(picture[0, 0, 0]) - 255 * level / 4095) <= 0.5 + 1e-3


def test_colours_are_returned_as_rgb() -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    image[..., 0] = 200  # blue, in OpenCV's order
    assert tuple(shown(image, 255, mark_clipped=False)[0, 0]) == (0, 0, 200)


def test_sharpness_falls_with_blur_and_not_with_the_exposure() -> None:
    rng = np.random.default_rng(3)
    scene = cv2.GaussianBlur(rng.uniform(5_000, 30_000, (1200, 1300)), (0, 0), 2.0)
    values = [sharpness(cv2.GaussianBlur(scene, (0, 0), blur).astype(np.uint16)) for blur in (0.1, 1.0, 2.0, 4.0)]
    assert values == sorted(values, reverse=True)
    assert values[0] > 2 * values[2] > 4 * values[3] > 0
    assert sharpness((2 * scene).astype(np.uint16)) == pytest.approx(sharpness(scene.astype(np.uint16)), rel=1e-3)
    assert sharpness(np.zeros((10, 10), np.uint8)) == 0
    assert sharpness(np.full((10, 10, 3), 80, np.uint8)) == pytest.approx(0, abs=1e-6)
