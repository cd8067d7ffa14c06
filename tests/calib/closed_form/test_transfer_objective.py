"""The search over focal lengths, on exact matches of a known corner."""

import numpy as np
import pytest

from calib.closed_form.transfer_objective import objective_for, search
from calib.synthetic import PAPER_CAMERA, random_capture


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_focal_of_the_true_camera_and_its_corner_are_found(seed: int) -> None:
    capture = random_capture(np.random.default_rng(seed), count=3000, noise_px=0.0)
    objective = objective_for(capture.matches, PAPER_CAMERA.principal_point_px)
    true_px = PAPER_CAMERA.focal_px[0]
    solution = search(objective, np.linspace(0.5 * true_px, 2 * true_px, 60))
    assert solution is not None
    assert solution.best_focal_px == pytest.approx(true_px, rel=0.01)
    (matrix,) = solution.best.matrix
    np.testing.assert_allclose(matrix, capture.calibration.projector.matrix, atol=0.01 * true_px)
    assert solution.best.rotation.shape == (1, 3, 3)
