"""Parts of the segmentation: surfels, lenses and parallax, robust least squares."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.geometry import Matches, homogeneous
from calib.numerics import Floats, minimise
from calib.plane_segmentation.plane_parallax import Lens, TwoView
from calib.plane_segmentation.surfels import make_surfels

SMALL = st.floats(-0.1, 0.1)


def grid(width: int, height: int) -> Floats:
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    return np.stack([x.ravel(), y.ravel()], axis=1)


@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_surfels_recover_an_affine_map(outliers: float) -> None:
    rng = np.random.default_rng(0)
    camera_px = grid(200, 150)
    slope, offset = np.array([[0.6, 0.1], [-0.2, 0.7]]), np.array([50.0, 30.0])
    projector_px = camera_px @ slope.T + offset + rng.normal(0, 0.1, camera_px.shape)
    wrong = rng.random(len(camera_px)) < outliers
    projector_px[wrong] = rng.uniform(0, 300, (int(wrong.sum()), 2))
    surfels = make_surfels(Matches(camera_px, projector_px), (200, 150), rng)
    assert len(surfels) > 200
    error = surfels.projector_px - surfels.camera_px @ slope.T - offset
    # A mean over about twenty matches of 0.1 px.
    assert 0.01 < np.median(np.abs(error)) < 0.03
    assert np.mean(np.abs(error) > 0.15) < 0.01
    assert 0.005 < np.median(np.abs(surfels.jacobian - slope)) < 0.03
    assert np.median(surfels.sigma_px) == pytest.approx(0.1, rel=0.1)


def test_surfels_at_a_step_belong_to_one_side() -> None:
    camera_px = grid(203, 150)
    right = camera_px[:, 0] > 100
    projector_px = 0.5 * camera_px + right[:, None] * np.array([20.0, 5.0])
    surfels = make_surfels(Matches(camera_px, projector_px), (203, 150), np.random.default_rng(0))
    from_left = np.linalg.norm(surfels.projector_px - 0.5 * surfels.camera_px, axis=1)
    from_right = np.linalg.norm(surfels.projector_px - 0.5 * surfels.camera_px - (20.0, 5.0), axis=1)
    assert len(surfels) > 0.9 * surfels.tried
    assert np.all(np.minimum(from_left, from_right) < 1e-9)
    assert np.all(surfels.camera_px[from_left < 1, 0] <= 100)


def test_random_matches_make_no_surfels() -> None:
    rng = np.random.default_rng(0)
    camera_px = grid(200, 150)
    surfels = make_surfels(Matches(camera_px, rng.uniform(0, 500, camera_px.shape)), (200, 150), rng)
    assert len(surfels) < 0.02 * surfels.tried


@given(k1=SMALL, k2=SMALL, x=SMALL, y=SMALL, u=st.floats(0, 1223), v=st.floats(0, 1023))
def test_lens_derivatives_match_differences(k1: float, k2: float, x: float, y: float, u: float, v: float) -> None:
    lens, pixel, step = Lens((1224, 1024), k1, k2, (x, y)), np.array([[u, v]]), 1e-6
    analytic = lens.jacobian(pixel)[0]
    for term in range(4):
        shift = step * np.eye(4)[term]
        ahead = lens.with_parameters(lens.parameters + shift).ideal(pixel)
        behind = lens.with_parameters(lens.parameters - shift).ideal(pixel)
        assert np.allclose((ahead - behind)[0] / (2 * step), analytic[:, term], atol=1e-7)


def test_a_lens_without_terms_only_normalises() -> None:
    lens = Lens((1224, 1024))
    assert lens.ideal(np.array([[611.5, 511.5], [1223.5, 511.5]])) == pytest.approx(np.array([[0.0, 0.0], [1.0, 0.0]]))


def test_parallax_on_a_plane_is_affine() -> None:
    rng = np.random.default_rng(0)
    view = TwoView(Lens((1224, 1024), 0.03), Lens((854, 480)), np.eye(3), np.array([0.8, 0.1, 0.1]))
    plane, camera_px = np.array([0.2, -0.1, 0.3]), rng.uniform((0, 0), (1224, 1024), (100, 2))
    x = homogeneous(view.camera.ideal(camera_px))
    ideal = x @ view.homography(plane).T
    projector_px = ideal[:, :2] / ideal[:, 2:] * 427 + (426.5, 239.5)
    parallax = view.parallax(camera_px, projector_px)
    assert np.allclose(parallax.value, x @ plane, atol=1e-9)
    assert np.allclose(parallax.across_px, 0, atol=1e-6)
    # One pixel along the epipolar line is what `per_px` says.
    along = np.array([0.8, 0.1]) - 0.1 * (ideal[:, :2] / ideal[:, 2:])
    moved = projector_px + 1e-3 * along / np.linalg.norm(along, axis=1, keepdims=True)
    change = (view.parallax(camera_px, moved).value - parallax.value) / 1e-3
    assert np.allclose(np.abs(change), parallax.per_px, rtol=1e-2)


def test_outliers_do_not_bias_the_fit() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 1, 200)
    y = 2 * x + 1 + rng.normal(0, 0.01, len(x))
    y[::5] += rng.uniform(5, 50, len(y[::5]))
    design = np.stack([x, np.ones_like(x)], axis=1)

    def evaluate(parameters: Floats) -> tuple[Floats, Floats]:
        return ((design @ parameters - y) / 0.03)[:, None], (design / 0.03)[:, None, :]

    found = minimise(evaluate, np.array([1.5, 0.5]), np.full(2, np.inf))
    assert 1e-6 < np.max(np.abs(found.parameters - (2, 1))) < 0.005
    swayed = minimise(evaluate, np.array([1.5, 0.5]), np.full(2, np.inf), robust=False)
    assert swayed.parameters == pytest.approx(np.linalg.lstsq(design, y)[0], abs=1e-6)
    assert 3 < np.max(np.abs(swayed.parameters - (2, 1))) < 15


def test_a_prior_determines_what_the_data_leave_open() -> None:
    def evaluate(parameters: Floats) -> tuple[Floats, Floats]:
        return (parameters[:1] + parameters[1:] - 1.0).reshape(1, 1) / 1e-3, np.full((1, 1, 2), 1e3)

    found = minimise(evaluate, np.zeros(2), np.array([1.0, 0.1])).parameters
    # The sum is 1; the parts are shared out in the ratio of the priors' variances.
    assert found == pytest.approx([1 / 1.01, 0.01 / 1.01], abs=1e-3)
