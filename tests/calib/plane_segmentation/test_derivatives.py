"""Derivatives for fits of planes and epipolar lines, compared with differences; and their sums."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from calib.numerics import Floats, minimise
from calib.plane_segmentation.fundamental_matrix import _epipolar_residuals, _Pairs, _plane_residuals
from calib.plane_segmentation.plane_parallax import Lens, TwoView
from calib.plane_segmentation.segmentation import residuals_of_planes

Evaluate = Callable[[Floats], tuple[Floats, Floats]]
CAMERA, PROJECTOR = Lens((1224, 1024), 0.03, -0.01, (0.02, -0.03)), Lens((854, 480), -0.02, 0.01, (-0.05, 0.1))
LENSES = np.concatenate([CAMERA.parameters, PROJECTOR.parameters])


@pytest.fixture
def pairs() -> _Pairs:
    rng = np.random.default_rng(0)
    camera_px, projector_px = (rng.uniform((0, 0), lens.size_px, (40, 2)) for lens in (CAMERA, PROJECTOR))
    return _Pairs(camera_px, projector_px, CAMERA, PROJECTOR)


def assert_derivatives(evaluate: Evaluate, parameters: Floats) -> None:
    analytic = evaluate(parameters)[1].copy()
    for column in range(len(parameters)):
        step = 1e-6 * np.eye(len(parameters))[column]
        ahead, behind = (evaluate(parameters + sign * step)[0].copy() for sign in (1, -1))
        difference = (ahead - behind) / 2e-6
        assert np.abs(difference - analytic[:, :, column]).max() < 1e-6 * max(1.0, np.abs(difference).max())
    assert np.all(np.abs(analytic).max(axis=(0, 1)) > 0)


def test_derivatives_of_distances_from_a_homography(pairs: _Pairs) -> None:
    homography = np.eye(3) + np.random.default_rng(1).normal(0, 0.1, (3, 3))
    assert_derivatives(partial(_plane_residuals, pairs, 100.0), np.concatenate([LENSES, homography.ravel()]))


def test_derivatives_of_distances_from_epipolar_lines(pairs: _Pairs) -> None:
    fundamental = np.random.default_rng(2).normal(0, 1, (3, 3))
    assert_derivatives(partial(_epipolar_residuals, pairs, 100.0), np.concatenate([LENSES, fundamental.ravel()]))


def test_derivatives_of_distances_from_planes(pairs: _Pairs) -> None:
    rng = np.random.default_rng(3)
    view = TwoView(CAMERA, PROJECTOR, np.eye(3) + rng.normal(0, 0.1, (3, 3)), np.array([0.8, 0.1, 0.1]))
    planes, label = rng.normal(0, 0.3, (3, 3)), rng.integers(0, 3, 40)
    evaluate, start = residuals_of_planes(pairs.camera_px, pairs.projector_px, label, view, planes, 100.0)
    assert_derivatives(evaluate, start)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize(("matches", "dimensions"), [(1, 1), (300, 2)])
def test_normal_equations_are_sums_over_matches(order: str, matches: int, dimensions: int) -> None:
    rng = np.random.default_rng(4)
    residual, jacobian = rng.normal(size=(matches, dimensions)), rng.normal(size=(matches, dimensions, 9))
    jacobian[: matches // 2, :, 3:5] = 0.0  # as of planes that these are not on
    weight = 2 / (1 + np.sum(residual**2, axis=1))
    in_order = [np.asarray(array, order=order) for array in (residual, jacobian)]  # type: ignore[call-overload]
    at = minimise(lambda _: (in_order[0], in_order[1]), np.zeros(9), np.full(9, np.inf), steps=0)
    np.testing.assert_allclose(at.information, np.einsum("n,ndp,ndq->pq", weight, jacobian, jacobian), atol=1e-10)
    np.testing.assert_allclose(at.gradient, np.einsum("n,ndp,nd->p", weight, jacobian, residual), atol=1e-10)
