"""A grid of an image's pixels, and masks of it at full size."""

import numpy as np
import pytest

from scanner.decoding.light.samples import GridSample


@pytest.mark.parametrize("shape", [(225, 300), (7, 5), (1000, 1501), (224, 449)])
def test_a_grid_mask_is_enlarged_to_the_pixels_it_was_taken_from(shape: tuple[int, int]) -> None:
    grid = GridSample(shape)
    row, column = np.mgrid[: shape[0], : shape[1]]
    chosen = np.asarray(grid.of(column), np.float64) > shape[1] / 2
    assert np.array_equal(grid.of(grid.at_full_size(chosen)), chosen)
    beside = np.abs(column - shape[1] / 2) > grid.step
    assert np.array_equal(grid.at_full_size(chosen)[beside], (column > shape[1] / 2)[beside])
    assert np.array_equal(grid.rows, grid.of(row))
