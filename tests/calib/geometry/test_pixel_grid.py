"""Grids of oblong pixels, and of rows that stand aside, sample pictures where their pixels are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import PixelGrid, Size

DIAMOND = PixelGrid(aspect=0.5, odd_rows=0.5)
SIDES = st.integers(2, 60)


@given(aspect=st.floats(0.2, 5), odd_rows=st.floats(-0.5, 0.5), size=st.tuples(SIDES, SIDES))
def test_sizes_return_and_one_level_stays(aspect: float, odd_rows: float, size: tuple[int, int]) -> None:
    grid = PixelGrid(aspect, odd_rows)
    square = grid.square_size(size)
    assert grid.device_size(square) == size
    assert square.width >= size[0]
    assert square.height >= size[1]
    even = np.full((square.height, square.width), 77, np.uint8)
    assert np.array_equal(grid.sample(even), np.full(size[::-1], 77))
    assert np.array_equal(grid.spread(grid.sample(even)), even)


@given(grid=st.sampled_from([PixelGrid(0.5), DIAMOND, PixelGrid(0.5, -0.5), PixelGrid(2.0), PixelGrid(0.25, 0.25)]))
def test_what_pixels_show_is_shown_by_them(grid: PixelGrid) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (12, 16), dtype=np.uint8)
    light = grid.spread(picture)
    assert Size.of(light) == grid.square_size((16, 12))
    assert np.array_equal(grid.sample(light)[:, 1:-1], picture[:, 1:-1])


@pytest.mark.parametrize("odd_rows", [0.0, 0.5, -0.5])
def test_a_ramp_is_seen_where_the_pixels_are(odd_rows: float) -> None:
    # Level 3 x at square pixel x: a pixel's mean is that of its centre, 2 i + ½ and a pixel aside in odd rows.
    ramp = np.broadcast_to(3 * np.arange(64, dtype=np.uint8), (6, 64))
    sampled = PixelGrid(0.5, odd_rows).sample(ramp).astype(float)
    centre = 2 * np.arange(32) + 0.5
    for row in range(6):
        expected = 3 * (centre + 2 * odd_rows * (row % 2))
        assert np.abs(sampled[row] - expected)[1:-1].max() <= 0.5


def test_square_pixels_are_the_picture_itself() -> None:
    picture = np.zeros((4, 6), np.uint8)
    assert PixelGrid().sample(picture) is picture
    assert PixelGrid().spread(picture) is picture
