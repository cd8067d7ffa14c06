"""Patterns of pixels that are not square, told in square ones, are the same picture."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import PixelGrid
from scanner.patterns import Axis, Black, Gray, Pattern, Phase, White, Xor, in_square_pixels

AXES = st.sampled_from(["x", "y"])
CELLS = st.sampled_from([1, 2, 4])
GRAY = st.builds(Gray, AXES, st.integers(0, 9), st.just(10), CELLS, st.integers(0, 64), st.booleans())
XOR = st.builds(Xor, AXES, st.integers(0, 8), st.just(10), st.just(9), CELLS, st.integers(0, 64), st.booleans())
PHASE = st.builds(Phase, AXES, st.floats(8, 200), st.floats(-1, 1))
PATTERNS = st.one_of(st.just(White()), st.just(Black()), GRAY, XOR, PHASE)


@given(pattern=PATTERNS, aspect=st.sampled_from([0.25, 0.5, 1.0, 2.0]))
def test_each_pixel_shows_the_same_in_as_many_square_ones(pattern: Pattern, aspect: float) -> None:
    size = (96, 64)
    (stretched,), (width, height) = in_square_pixels([pattern], size, PixelGrid(aspect))
    across, down = round(max(1, 1 / aspect)), round(max(1, aspect))
    assert (width, height) == (across * size[0], down * size[1])
    # Where their centre is, in square pixels.
    x, y = np.meshgrid(np.arange(float(size[0])), np.arange(float(size[1])))
    middle_x, middle_y = (x + 0.5) * float(across) - 0.5, (y + 0.5) * float(down) - 0.5
    if isinstance(pattern, Phase):
        assert np.allclose(stretched.brightness(middle_x, middle_y), pattern.brightness(x, y), atol=1e-6)
        return
    for dx in range(across):
        for dy in range(down):
            assert np.array_equal(stretched.brightness(x * across + dx, y * down + dy), pattern.brightness(x, y))


@pytest.mark.parametrize("axis", ["x", "y"])
def test_square_pixels_stay(axis: Axis) -> None:
    patterns: list[Pattern] = [Gray(axis, 3, 8, 2, 16), Phase(axis, 20.0, 0.25)]
    assert in_square_pixels(patterns, (192, 108), PixelGrid()) == (tuple(patterns), (192, 108))
