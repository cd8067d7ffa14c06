"""Deviations from a cloud or a mesh, and the regions that they have."""

import numpy as np
import pytest

from calib.numerics import Floats, Ints
from calib.registration import CellDeviations, find_regions, from_mesh, from_samples, groups, inflated, sample_surface
from tests.support.blob import Blob

BLOB = Blob()


def test_points_off_a_surface_are_that_far_from_it() -> None:
    mesh = BLOB.mesh(40_000)
    points, normals = BLOB.cloud(5000, 0, noise=0.0)
    off = np.random.default_rng(1).uniform(-0.5, 0.5, len(points))
    lifted = points + off[:, None] * normals
    found = from_mesh(lifted, normals, *mesh, reach=2.0)
    assert found.there.mean() > 0.99
    assert np.nanstd(found.distance - off) < 0.01
    samples = sample_surface(*BLOB.cloud(80_000, 2, noise=0.0), 1.0, 0.0).on_surface()
    found = from_samples(lifted, normals, samples, np.zeros(len(samples)), reach=2.0)
    assert found.there.mean() > 0.95
    assert 1e-4 < np.nanstd(found.distance - off) < 0.02


def test_flipped_faces_change_no_sign() -> None:
    vertices, triangles = BLOB.mesh()
    points, normals = BLOB.cloud(3000, 3, noise=0.0)
    triangles[::2] = triangles[::2, ::-1]
    found = from_mesh(points + 0.3 * normals, normals, vertices, triangles, reach=2.0)
    assert np.nanmedian(found.distance) == pytest.approx(0.3, abs=0.01)
    assert np.nanmin(found.distance) > 0.2


def test_beyond_the_edge_of_a_mesh_there_is_nothing() -> None:
    vertices = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]])
    triangles: Ints = np.array([[0, 1, 2], [0, 2, 3]])
    points = np.array([[5.0, 5, 0.1], [11.0, 5, 0.1], [5, 5, 3.0]])
    up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    found = from_mesh(points, up, vertices, triangles, reach=2.0)
    assert found.distance[0] == pytest.approx(0.1, abs=1e-5)
    assert np.isnan(found.distance[1:]).all()


def cells(dent: float, noise: float, seed: int) -> tuple[CellDeviations, Floats]:
    """A plate of 100 × 100 cells with a round dent in its middle."""
    x, y = np.meshgrid(np.arange(100.0), np.arange(100.0))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(10_000)], axis=1)
    true = -dent * np.exp(-((np.hypot(points[:, 0] - 50, points[:, 1] - 50) / 6) ** 2))
    distance = true + noise * np.random.default_rng(seed).standard_normal(len(points))
    sigma, factor = inflated(np.full(len(points), noise), distance)
    normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    return CellDeviations(points, normals, distance, sigma, 1.0, factor), true


@pytest.mark.parametrize("seed", range(5))
def test_a_dent_is_one_region_with_its_depth(seed: int) -> None:
    made, true = cells(0.2, 0.02, seed)
    (region,) = find_regions(made)
    assert region.peak == pytest.approx(-0.2, abs=0.03)
    assert np.linalg.norm(region.centre[:2] - 50) < 1.5
    assert region.volume == pytest.approx(true.sum(), rel=0.25)
    assert 5 < region.size < 25
    assert not find_regions(cells(0.0, 0.02, seed)[0])


def test_sigmas_that_are_too_small_are_enlarged() -> None:
    distance = 0.1 * np.random.default_rng(0).standard_normal(5000)
    sigma, factor = inflated(np.full(5000, 0.05), distance)
    assert 1.9 < factor < 2.1
    assert np.allclose(sigma, 0.05 * factor)
    assert inflated(np.full(5000, 0.2), distance)[1] == 1.0


def test_cells_that_adjoin_are_one_group() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 0], [9, 0, 0], [50, 0, 0]])
    chosen = np.array([True, True, True, True, False])
    assert sorted(len(group) for group in groups(points, chosen, 1.0)) == [1, 3]
