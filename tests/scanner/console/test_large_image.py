"""The live image in the large area: fitted in, pixel by pixel, and what is said on it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.console.picture import CLIPPED_COLOUR, DARK_COLOUR, Placement, Shown, painted

WINDOW = (1010, 900)


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
