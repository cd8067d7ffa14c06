"""Maps and matches reduced for a page."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanner.rendering.downsampling import averaged, cells_over, extent, labels_on_grid, one_in_cells


@pytest.mark.parametrize("size", [(4, 3), (5, 4), (12, 9)])
def test_a_plane_stays_a_plane(size: tuple[int, int]) -> None:
    row, column = np.mgrid[:9, :12]
    reduced = averaged((2 + 0.5 * column - 0.25 * row).astype(np.float32), size)
    width, height = size
    x, y = (np.arange(width) + 0.5) * 12 / width - 0.5, (np.arange(height) + 0.5) * 9 / height - 0.5
    assert reduced.shape == (height, width)
    # Within a pixel that is cut in two, a plane is a step.
    assert np.abs(reduced - (2 + 0.5 * x - 0.25 * y[:, None])).max() < 0.12
    assert reduced.mean() == pytest.approx(2 + 0.5 * 5.5 - 0.25 * 4)


def test_missing_values_do_not_enter_the_average() -> None:
    values = np.full((4, 6), np.nan, np.float32)
    values[0, 0], values[1, 1], values[3, 4] = 1.0, 3.0, -5.0
    assert averaged(values, (3, 2)) == pytest.approx(
        np.array([[2.0, np.nan, np.nan], [np.nan, np.nan, -5.0]]), nan_ok=True
    )


@given(st.integers(1, 12), st.integers(1, 12), st.lists(st.tuples(st.integers(0, 11), st.integers(0, 11)), max_size=6))
def test_the_extent_of_valid_values(height: int, width: int, places: list[tuple[int, int]]) -> None:
    values = np.full((height, width), np.nan, np.float32)
    for row, column in places:
        values[row % height, column % width] = 0.0
    rows, columns = np.nonzero(np.isfinite(values))
    expected = (rows.min(), rows.max(), columns.min(), columns.max()) if len(rows) else (0, -1, 0, -1)
    assert extent(values) == expected


def test_labels_and_matches_of_cells() -> None:
    rng = np.random.default_rng(1)
    size = (200, 100)
    camera_px = rng.uniform((-5, -5), (205, 105), (3000, 2))
    label = rng.integers(-1, 3, 3000).astype(np.int32)
    side, rows, columns = cells_over(size, 300)
    assert (side, rows, columns) == (9, 12, 23)
    drawn = one_in_cells(camera_px, side, rows, columns)
    grid = labels_on_grid(camera_px, label, size, (20, 10))
    assert (drawn >= 0).mean() > 0.8
    for (row, column), found in np.ndenumerate(drawn):
        inside = np.all(np.floor((camera_px + 0.5) / side) == (column, row), axis=1)
        assert found in np.flatnonzero(inside) if inside.any() else found == -1
    for (row, column), shown in np.ndenumerate(grid):
        inside = np.all(np.floor((camera_px + 0.5) / 10) == (column, row), axis=1) & (label >= 0)
        assert shown - 1 == (label[inside][-1] if inside.any() else -1)


def test_samples_are_spread_over_their_cells() -> None:
    """With a match at every pixel, samples form no grid, and pixels are equally likely."""
    pixels = np.stack(np.meshgrid(np.arange(350.0), np.arange(280.0)), -1).reshape(-1, 2)
    drawn = one_in_cells(pixels, 7, 40, 50)
    places, counts = np.unique(pixels[drawn.ravel()] % 7, axis=0, return_counts=True)
    assert len(places) == 49
    assert 10 < counts.min() < counts.max() < 80  # 41 on average
