"""The image of a corner, and intrinsics that it carries from one device to the other, compared with known corners."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.closed_form.transfer import image_of_corner, intrinsic_matrices, transfer
from calib.geometry import corner_planes, face_grams
from calib.synthetic import PAPER_CAMERA, random_capture

SEEDS = st.integers(0, 10_000)


@settings(max_examples=15)
@given(seed=SEEDS)
def test_the_image_of_the_vertex(seed: int) -> None:
    capture = random_capture(np.random.default_rng(seed), count=3000, noise_px=0.0)
    image = image_of_corner(face_grams(capture.matches))
    vertex = image.vertex[:2] / image.vertex[2]
    assert vertex == pytest.approx(PAPER_CAMERA.project(capture.corner.vertex[None])[0], abs=1e-2)


@settings(max_examples=15)
@given(seed=SEEDS)
def test_both_solutions_are_square_and_one_is_the_true_corner(seed: int) -> None:
    capture = random_capture(np.random.default_rng(seed), count=3000, noise_px=0.0)
    image = image_of_corner(face_grams(capture.matches))
    inverse: Any = np.linalg.inv(intrinsic_matrices(np.array([1791.1]), PAPER_CAMERA.principal_point_px))
    normals, rays = corner_planes(image, inverse)
    for solution in normals[:, 0]:
        assert np.allclose(solution @ solution.T, np.eye(3), atol=1e-6)
    # Parallel or antiparallel to the true normals, face by face.
    agreement = np.abs(np.einsum("nsi,si->ns", normals[:, 0], capture.corner.normals)).min(axis=1)
    assert agreement.max() > 1 - 1e-6
    assert agreement.min() < 1 - 1e-3
    assert rays[0] @ capture.corner.vertex == pytest.approx(np.linalg.norm(capture.corner.vertex), rel=1e-6)


@settings(max_examples=15)
@given(seed=SEEDS)
def test_transferring_the_true_camera_gives_the_true_projector(seed: int) -> None:
    capture = random_capture(np.random.default_rng(seed), count=3000, noise_px=0.0)
    grams = face_grams(capture.matches)
    matrices = intrinsic_matrices(np.array([1791.1]), PAPER_CAMERA.principal_point_px)
    result = transfer(grams, image_of_corner(grams), matrices)
    errors = np.abs(result.matrix - capture.calibration.projector.matrix).max(axis=(1, 2))
    best = int(np.nanargmin(errors))
    assert errors[best] < 0.5
    assert np.allclose(result.rotation[best], capture.calibration.pose.rotation, atol=1e-3)
    direction = result.translation[best] / np.linalg.norm(result.translation[best])
    truth = capture.calibration.pose.translation / capture.calibration.baseline
    assert np.allclose(direction, truth, atol=2e-3)
