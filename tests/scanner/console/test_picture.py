"""Frames for display: clipping, brightness, and the reduced picture.

The live image in the large area: fitted in, pixel by pixel, and what is said on it.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from scanner.console.picture import (
    CLIPPED_COLOUR,
    DARK_COLOUR,
    HISTOGRAM_BINS,
    Placement,
    Shown,
    clipped_pixels,
    exposed,
    histogram,
    painted,
    sharpness,
    shown,
)

WINDOW = (1010, 900)


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


def content(image: np.ndarray, *, mark: bool = True) -> Shown:
    return Shown(image, 255, mark, (), np.zeros(64))


@given(st.tuples(st.integers(8, 5000), st.integers(8, 5000)), st.tuples(st.integers(50, 3000), st.integers(50, 3000)))
def test_a_fitted_image_fills_one_side_and_is_in_the_middle(image: tuple[int, int], free: tuple[int, int]) -> None:
    place = Placement.of(image, free)
    low, high = place.corner, place.corner + place.scale * np.array(image)
    assert np.min(low) == pytest.approx(0, abs=1e-6)
    assert low + high == pytest.approx(np.array(free, float))


@given(st.floats(0, 1), st.floats(0, 1), st.sampled_from([1, 2, 3]))
def test_zoomed_the_chosen_pixel_is_in_the_middle(x: float, y: float, density: int) -> None:
    centre = np.array([x * 1224, y * 1024])
    place = Placement.of((1224, 1024), WINDOW, centre, density)
    assert place.pixel_at(np.array(WINDOW) / 2) == pytest.approx(centre)
    assert place.scale == 8 * density


def test_clipped_and_dark_pixels_are_marked_where_they_are() -> None:
    image = np.full((512, 612), 100, np.uint8)
    image[100, 200], image[300:340, 400:440] = 255, 2
    marked = painted(content(image), WINDOW, WINDOW, None)
    assert marked.shape == (900, 1010, 3)
    place = Placement.of((612, 512), WINDOW)
    for colour, pixel in ((CLIPPED_COLOUR, (200.5, 100.5)), (DARK_COLOUR, (420, 320))):
        rows, columns = np.nonzero((marked == colour).all(axis=2))
        expected = place.scale * np.array(pixel) + place.corner
        assert (np.mean(columns) + 0.5, np.mean(rows) + 0.5) == pytest.approx(expected, abs=1.5)
    assert (marked == CLIPPED_COLOUR).all(axis=2).sum() in (1, 2, 4)
    plain = painted(content(image, mark=False), WINDOW, WINDOW, None)
    assert not (plain == CLIPPED_COLOUR).all(axis=2).any()
    assert not (plain == DARK_COLOUR).all(axis=2).any()


def test_a_single_pixel_is_a_square_when_zoomed() -> None:
    image = np.full((1024, 1224), 100, np.uint8)
    image[600, 700] = 255
    zoomed = painted(content(image), WINDOW, WINDOW, np.array([700.5, 600.5]))
    rows, columns = np.nonzero((zoomed == CLIPPED_COLOUR).all(axis=2))
    assert [int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1, len(rows)] == [8, 8, 64]
    assert np.mean(rows) == pytest.approx(450, abs=1)
    assert np.mean(columns) == pytest.approx(505, abs=1)


@pytest.mark.parametrize("centre", [None, (0.0, 0.0), (1224.0, 1024.0), (600.0, -50.0)])
@pytest.mark.parametrize("free", [WINDOW, (1010, 495), (1, 1)])
def test_every_part_can_be_looked_at(centre: tuple[float, float] | None, free: tuple[int, int]) -> None:
    image = np.full((1024, 1224, 3), 100, np.uint8)
    drawn = painted(content(image), WINDOW, free, None if centre is None else np.array(centre))
    assert drawn.shape == (900, 1010, 3)
    assert np.all(drawn[free[1] + 10 :] == drawn[-1, -1])  # what a panel covers stays empty


def test_the_histogram_and_the_lines_are_drawn() -> None:
    image = np.full((512, 612), 100, np.uint8)
    counts = np.zeros(64)
    counts[10], counts[50] = 1000, 10
    drawn = painted(Shown(image, 255, True, ("Focus: 93 %",), counts), WINDOW, WINDOW, None)
    changed = np.any(drawn != painted(Shown(image, 255, True, (), np.zeros(64)), WINDOW, WINDOW, None), axis=2)
    rows, columns = np.nonzero(changed)
    assert rows.min() > 700
    assert columns.max() < 300
    bars = np.all(drawn[:, 12:268] == 150, axis=2).sum(axis=0)
    assert bars[42] > 2 * bars[202] > 0  # logarithmic
