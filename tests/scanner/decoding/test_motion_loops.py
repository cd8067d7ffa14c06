"""The compiled loops of motion measurement, against known motions and against NumPy."""

import numpy as np
import pytest

from calib.numerics import SIGMA_PER_MEDIAN
from scanner.decoding.motion.fringe_fit import FringeFit
from scanner.decoding.motion.pixels import _planes
from scanner.decoding.motion.rigid import COLUMNS, fit_motion
from scanner.decoding.samples import TILE_PX, TileSample

PERIOD, SHIFTS = 8.0, np.arange(6) / 6
# The completed share of the motion in each frame.
TRAJECTORY = np.array([0.0, 0.0, 0.0, 0.4, 1.0, 1.0])


def fringe(motion_px: float) -> FringeFit:
    """A fringe in 500 pixels that move by `motion_px`."""
    rng = np.random.default_rng(4)
    position, amplitude = rng.uniform(0, PERIOD, 500), rng.uniform(20, 90, 500)
    angle = 2 * np.pi * ((position + motion_px * TRAJECTORY[:, None]) / PERIOD + SHIFTS[:, None])
    return FringeFit(100 + amplitude * np.cos(angle), SHIFTS, PERIOD, np.full(500, 2.0), np.arange(6))


@pytest.mark.parametrize("known_px", [None, 0.0])
def test_a_fringe_measures_a_motion_and_its_response_to_it(known_px: float | None) -> None:
    rest, moved = fringe(0.0), fringe(1e-3)
    if known_px is not None:  # a known motion of each pixel
        moved = FringeFit(moved.levels, SHIFTS, PERIOD, moved.noise, moved.times, np.full((6, 500), known_px))
    observed = moved.response_to(TRAJECTORY)
    shifted = (moved.position - rest.position + PERIOD / 2) % PERIOD - PERIOD / 2
    assert np.median(np.abs(observed.response - shifted / 1e-3)) < 2e-3
    assert 0.2 < np.median(observed.response) < 0.8
    # The fit of a second harmonic, two numbers for all pixels, takes away a little of it.
    assert np.median(observed.motion_px) == pytest.approx(1e-3, rel=0.1)
    assert np.all(observed.precision > 0)
    assert not rest.response_to(np.ones(6)).precision.any()


def test_the_motion_is_the_robust_mean_of_the_observations() -> None:
    rng = np.random.default_rng(7)
    design, group = rng.normal(0, 1, (300, COLUMNS)), np.repeat(np.arange(30), 10)
    row = np.concatenate([np.arange(300), rng.integers(0, 300, 500)])
    truth, precision = rng.normal(0, 0.5, COLUMNS), rng.uniform(50, 500, len(row))
    seen = (design @ truth)[row] + rng.normal(0, 1, len(row)) / np.sqrt(precision)
    seen[::9] += 3.0
    weight, prior = precision, np.eye(COLUMNS)
    for _ in range(6):
        normal = design[row].T @ (weight[:, None] * design[row]) + prior
        motion = np.linalg.solve(normal, design[row].T @ (weight * seen))
        off = np.abs(seen - design[row] @ motion) * np.sqrt(precision)
        scale = SIGMA_PER_MEDIAN * np.median(off)
        weight = precision * np.minimum(1, 2 * scale / off)
    found = fit_motion(design, seen, precision, row, group)
    np.testing.assert_allclose(found.motion, motion, rtol=1e-9)
    scores = weight * (seen - design[row] @ motion)
    sums = np.stack([np.bincount(group[row], design[row, column] * scores) for column in range(COLUMNS)])
    inverse = np.linalg.inv(normal)
    np.testing.assert_allclose(found.covariance, inverse @ sums @ sums.T @ inverse + scale**2 * inverse, rtol=1e-6)
    assert 1.0 < np.max(np.abs(truth - found.motion) / np.sqrt(np.diag(found.covariance))) < 4.0


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
