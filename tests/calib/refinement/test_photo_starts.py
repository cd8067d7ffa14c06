"""Starts for a pair of photos: the true focal length gives the true pose of camera and corner."""

import numpy as np
import pytest

from calib.estimation import into_cells
from calib.refinement.focal_sweep import objective_of_photos, photo_family
from calib.refinement.likelihood import Knowledge
from calib.synthetic import random_photos


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_starts_at_the_true_focal_include_the_truth(seed: int) -> None:
    photos = random_photos(np.random.default_rng([7, seed]))
    matches, truth = photos.pairs[0]
    size = photos.camera.width, photos.camera.height
    knowledge = Knowledge(size, size, photos.camera.principal_point_px, 0.0, 0.0, one_camera=True)
    (starts,) = photo_family(into_cells(matches), knowledge).starts(np.array([photos.camera.focal_px[0]]))
    assert 1 <= len(starts) <= 2
    best = min(starts, key=lambda state: float(np.linalg.norm(state.pose.rotation - truth.pose.rotation)))
    assert best.one_camera
    assert best.camera is best.projector
    np.testing.assert_allclose(best.camera[:3], [photos.camera.focal_px[0], *photos.camera.principal_point_px])
    np.testing.assert_allclose(best.pose.rotation, truth.pose.rotation, atol=0.03)
    direction = truth.pose.translation / truth.baseline
    np.testing.assert_allclose(best.pose.translation, direction, atol=0.05)
    np.testing.assert_allclose(best.corners[0].vertex, photos.corner.vertex, rtol=0.1, atol=0.02)


def test_the_objective_is_the_difference_of_the_cameras() -> None:
    matrix = np.array([[1010.0, 2.0, 503.0], [0.0, 980.0, 399.0], [0.0, 0.0, 1.0]])
    assert objective_of_photos(matrix[None], np.array([1000.0]), np.array([500.0, 400.0])) == pytest.approx([36.0])
