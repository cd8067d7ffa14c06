"""Planes through the coordinates of a tile's pixels, and the motion of a device as their robust mean."""

import numpy as np
import pytest

from calib.numerics import MEDIAN_LENGTH
from scanner.decoding import TILE_PX, TileSample
from scanner.decoding.motion import fit_motion
from scanner.decoding.motion.fringe_pixels import _planes
from scanner.decoding.motion.rigid_motion import COLUMNS, PRIOR_PX


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


def test_the_motion_is_the_robust_mean_of_the_observations() -> None:
    rng = np.random.default_rng(7)
    design, group = rng.normal(0, 20, (300, 2, COLUMNS)), np.repeat(np.arange(30), 10)
    truth, prior = rng.normal(0, 0.5, COLUMNS), np.eye(COLUMNS) / PRIOR_PX**2
    seen = design @ truth + rng.normal(0, 1, (300, 2))
    seen[::9] += 50.0
    rows, weight = design.reshape(-1, COLUMNS), np.ones(600)
    for _ in range(6):
        normal = rows.T @ (weight[:, None] * rows) + prior
        motion = np.linalg.solve(normal, rows.T @ (weight * seen.reshape(-1)))
        off = (seen.reshape(-1) - rows @ motion).reshape(-1, 2)
        size = np.linalg.norm(off, axis=1)
        scale = np.median(size) / MEDIAN_LENGTH
        weight = np.repeat(np.minimum(1, 2 * scale / size), 2)
    found = fit_motion(design, seen, group)
    np.testing.assert_allclose(found.motion, motion, atol=5e-3)
    scores = weight * off.reshape(-1)
    sums = np.stack([np.bincount(np.repeat(group, 2), column * scores) for column in rows.T])
    inverse = np.linalg.inv(normal)
    sigmas = np.sqrt(np.diag(inverse @ sums @ sums.T @ inverse + scale**2 * inverse))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sigmas, rtol=0.1)
    assert 0.3 < np.max(np.abs(truth - found.motion) / np.sqrt(np.diag(found.covariance))) < 4.0
