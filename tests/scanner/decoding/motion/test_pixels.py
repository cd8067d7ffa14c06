"""Planes through the coordinates of a tile's pixels."""

import numpy as np
import pytest

from scanner.decoding import TILE_PX, TileSample
from scanner.decoding.motion.pixels import _planes


def test_plane_fits_exclude_outliers() -> None:
    tiles = TileSample((60, 60))
    number = len(tiles.tile)
    u, v = tiles.camera_px.T
    seen = np.stack([3 + 0.8 * u - 0.1 * v, 5 + 0.05 * u + 0.7 * v], axis=1)
    seen += np.random.default_rng(1).normal(0, 0.01, seen.shape)
    is_off = np.arange(number) % 29 == 0
    seen[is_off, 0] += 3.0
    unlit = tiles.tile == 2
    planes, on = _planes(tiles, seen, ~unlit)
    np.testing.assert_array_equal(on, ~is_off & ~unlit)
    others = np.arange(tiles.count) != 2
    np.testing.assert_allclose(planes[others][:, 1:].transpose(0, 2, 1)[0], [[0.8, -0.1], [0.05, 0.7]], atol=3e-3)
    centre = np.full(2, (TILE_PX - 1) / 2) + tiles.camera_px[0]
    assert planes[0, 0] == pytest.approx(
        [3 + 0.8 * centre[0] - 0.1 * centre[1], 5 + 0.05 * centre[0] + 0.7 * centre[1]], abs=0.01
    )
