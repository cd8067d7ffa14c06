"""Planes grow from a patch, and cells are fitted."""

import numpy as np
import pytest

from calib.numerics import Floats, Ints
from calib.plane_segmentation.affine_ransac import CellFits, fit_cells
from calib.plane_segmentation.region_growing import grow, local_planes
from calib.plane_segmentation.surfels import Grid, Surfels

GATE = 3.5


def evidence_of(planes: Floats, label: Ints, x: Floats, rng: np.random.Generator) -> Floats:
    """Rows (12, M) of surfels at x (M, 2) on the planes named by label (M,), with errors of standard deviation 1."""
    rows = np.empty((12, len(x)))
    at = np.concatenate([x, np.ones((len(x), 1))], axis=1)
    rows[1:4] = 1000 * at.T
    rows[5:8], rows[9:12] = 40 * np.array([[1.0], [0], [0]]), 40 * np.array([[0.0], [1], [0]])
    for row in (0, 4, 8):
        rows[row] = np.sum(rows[row + 1 : row + 4].T * planes[label], axis=1) + rng.normal(size=len(x))
    return rows


def test_a_seed_grows_over_its_plane_and_no_other() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (3000, 2))
    planes = np.array([[0.3, -0.2, 0.5], [-0.4, 0.1, 0.5]])
    label = (x[:, 0] > 0.3).astype(np.int32)
    rows = evidence_of(planes, label, x, rng)
    seeds = np.repeat(planes + 0.01, 5, axis=0)
    uncertain = np.tile(np.array([1e-4, 0, 0, 1e-4, 0, 1e-4]), (10, 1))
    plane, inlier = grow(rows, seeds, uncertain, GATE)
    assert 1e-6 < np.abs(plane - planes[0]).max() < 0.001
    assert np.mean(inlier[label == 0]) > 0.99
    assert np.mean(inlier[label == 1]) < 0.02


def test_the_seed_that_explains_most_wins() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, (1000, 2))
    label = (rng.random(1000) < 0.3).astype(np.int32)
    planes = np.array([[0.3, -0.2, 0.5], [0.3, -0.2, 0.9]])
    rows = evidence_of(planes, label, x, rng)
    nowhere = np.array([[5.0, 5.0, 5.0]])
    plane, inlier = grow(rows, np.concatenate([nowhere, planes[::-1]]), np.full((3, 6), 1e-9), GATE)
    assert np.abs(plane - planes[0]).max() < 0.001
    assert np.mean(inlier == (label == 0)) > 0.98
    assert not grow(rows, nowhere, np.full((1, 6), 1e-9), GATE)[1].any()


def test_patches_are_planes_away_from_a_crease() -> None:
    rng = np.random.default_rng(2)
    grid = Grid(8.0, 40, 30)
    cell = np.arange(1200, dtype=np.int32)
    x = np.stack([cell % 40 / 20 - 1, cell // 40 / 20 - 0.75], axis=1)
    label = (x[:, 0] > 0.01).astype(np.int32)
    planes = np.array([[0.3, -0.2, 0.5], [-0.4, 0.1, 0.5]])
    rows = evidence_of(planes, label, x, rng)
    zero = np.zeros((1200, 2))
    surfels = Surfels(grid, cell, zero, zero, np.zeros((1200, 2, 2)), zero[:, 0], np.zeros((1200, 2, 2)), cell, 1200)
    found, covariance, usable = local_planes(surfels, rows, GATE)
    assert np.mean(usable[np.abs(x[:, 0]) > 0.2]) > 0.98
    assert not np.any(usable[(np.abs(x[:, 0]) < 0.02)])
    # In units of its own uncertainty, along the axis of the parallax itself.
    error = (found[:, 2] - planes[label][:, 2])[usable] / np.sqrt(covariance[usable, 5])
    assert np.std(error) == pytest.approx(1.0, abs=0.15)


SLOPE = np.array([[0.6, 0.1], [-0.2, 0.7]])


def fit_one(camera_px: Floats, projector_px: Floats, rng: np.random.Generator) -> CellFits:
    count = len(camera_px)
    picks = rng.integers(0, count, (10, 3, 1)).astype(np.int32)
    order = rng.permutation(count).astype(np.int32)
    return fit_cells(camera_px, projector_px, order, np.zeros(1, np.int32), np.full(1, count, np.int32), picks)


def test_a_cell_is_the_least_squares_of_its_inliers() -> None:
    rng = np.random.default_rng(3)
    camera_px = rng.uniform(0, 10, (40, 2))
    projector_px = camera_px @ SLOPE.T + rng.uniform(-0.01, 0.01, (40, 2))
    projector_px[:8] += rng.uniform(1, 5, (8, 2))
    fits = fit_one(camera_px, projector_px, rng)
    assert fits.count[0] == 32
    camera_px, projector_px = camera_px[8:], projector_px[8:]
    from_mean = camera_px - camera_px.mean(axis=0)
    value = projector_px.mean(axis=0)
    expected, square, _, _ = np.linalg.lstsq(from_mean, projector_px - value)
    np.testing.assert_allclose(fits.mean[0], camera_px.mean(axis=0))
    np.testing.assert_allclose(fits.value[0], value)
    np.testing.assert_allclose(fits.jacobian[0], expected.T, atol=1e-9)
    np.testing.assert_allclose(fits.spread[0], from_mean.T @ from_mean)
    assert fits.square[0] == pytest.approx(square.sum())


def test_matches_on_a_line_leave_the_perpendicular_direction_open() -> None:
    rng = np.random.default_rng(4)
    along = np.array([0.6, 0.8])
    camera_px = rng.uniform(0, 10, (40, 1)) * along
    fits = fit_one(camera_px, camera_px @ SLOPE.T + rng.normal(0, 0.01, (40, 2)), rng)
    assert 1e-5 < np.abs(fits.jacobian[0] @ along - SLOPE @ along).max() < 0.01
    assert np.abs(fits.jacobian[0] @ (-along[1], along[0])).max() < 1e-6
