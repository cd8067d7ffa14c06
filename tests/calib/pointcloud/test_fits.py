"""Spheres and planes through known points: exact, with noise, with outliers, and with true sigmas."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calib.geometry import intersect
from calib.numerics import biweight, blocks, robust_covariance, robust_sigma
from calib.pointcloud.plane_fit import dihedral_angle_rad, fit_plane
from calib.pointcloud.sphere_fit import fit_sphere
from calib.pointcloud.triangulation_errors import point_covariances
from tests.support.cloud_scene import room

CENTRE, RADIUS = np.array([0.3, -0.2, 2.5]), 0.0254


def cap(n: int, rng: np.random.Generator, radius: float = RADIUS) -> NDArray[np.float64]:
    """Points on the side of the sphere that faces the camera, up to 70° from it."""
    cosine = rng.uniform(np.cos(np.radians(70)), 1, n)
    angle = rng.uniform(0, 2 * np.pi, n)
    sine = np.sqrt(1 - cosine**2)
    return CENTRE + radius * np.stack([sine * np.cos(angle), sine * np.sin(angle), -cosine], axis=1)


@given(
    st.floats(0.01, 10), st.floats(-5, 5), st.floats(-5, 5), st.floats(1, 10), st.floats(0.9, 1.1), st.integers(0, 99)
)
@settings(max_examples=40)
def test_exact_points_give_the_exact_sphere(
    radius: float, x: float, y: float, z: float, start: float, seed: int
) -> None:
    points = cap(60, np.random.default_rng(seed), radius) - CENTRE + (x, y, z)
    found = fit_sphere(points, np.arange(60), np.array([x, y, z]) + 0.1 * radius, start * radius)
    assert np.allclose(found.centre, (x, y, z), atol=1e-7 * radius + 1e-9)
    assert np.isclose(found.radius, radius, rtol=1e-7)


def errors_in_sigmas(alike: int, trials: int = 150) -> NDArray[np.float64]:
    """(Fitted − true radius and centre) over sigma, (trials, 4); groups of `alike` neighbours share their error."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(trials):
        points = cap(600 // alike, rng)
        cluster = np.repeat(np.arange(len(points)), alike)
        outward = (points - CENTRE) / RADIUS
        points = points + outward * rng.normal(0, 2e-4, (len(points), 1))
        sphere = fit_sphere(np.repeat(points, alike, axis=0), cluster, CENTRE, RADIUS)
        error = np.array([*(sphere.centre - CENTRE), sphere.radius - RADIUS])
        found.append(error / [*sphere.centre_sigma, sphere.radius_sigma])
    return np.array(found)


@pytest.mark.parametrize("alike", [1, 10])
def test_sphere_errors_match_their_sigmas(alike: int) -> None:
    rms = np.sqrt(np.mean(errors_in_sigmas(alike) ** 2, axis=0))
    assert np.all((rms > 0.8) & (rms < 1.25)), rms


def test_outliers_do_not_move_the_sphere() -> None:
    rng = np.random.default_rng(3)
    points = cap(1000, rng)
    points += (points - CENTRE) / RADIUS * rng.normal(0, 1e-4, (1000, 1))
    points[:100] *= 1.002  # 5 mm behind, a fifth of the radius
    found = fit_sphere(points, np.arange(1000), CENTRE, RADIUS)
    assert 1e-8 < abs(found.radius - RADIUS) < 3e-5
    assert np.median(np.abs(found.residual[:100])) > 1e-3


def test_with_a_fixed_radius_only_the_centre_is_fitted() -> None:
    points = cap(500, np.random.default_rng(4))
    found = fit_sphere(points, np.arange(500), CENTRE, 1.01 * RADIUS, fixed_radius=True)
    assert found.radius == 1.01 * RADIUS
    assert found.radius_sigma == 0
    assert 1e-5 < np.abs(found.residual).mean() < 1e-4


def test_too_few_points_are_refused() -> None:
    with pytest.raises(ValueError, match="four points, found 3"):
        fit_sphere(cap(3, np.random.default_rng(0)), np.arange(3), CENTRE, RADIUS)
    with pytest.raises(ValueError, match="three points, found 2"):
        fit_plane(np.eye(3)[:2], np.arange(2))
    with pytest.raises(ValueError, match="in a line"):
        fit_plane(np.arange(5.0)[:, None] * np.ones(3) + 1, np.arange(5))


def face(normal: NDArray[np.float64], rng: np.random.Generator, noise: float) -> NDArray[np.float64]:
    across = np.linalg.svd(normal[None])[2][1:]
    points = np.array([0, 0, 3.0]) + rng.uniform(-0.5, 0.5, (400, 2)) @ across
    return points + rng.normal(0, noise, (400, 1)) * normal


def test_angle_errors_match_their_sigmas() -> None:
    rng = np.random.default_rng(11)
    a, b = np.array([0.6, 0.1, -0.8]), np.array([-0.7, 0.2, -0.6])
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    errors = []
    for _ in range(150):
        planes = [fit_plane(face(normal, rng, 1e-3), np.arange(400)) for normal in (a, b)]
        angle, sigma = dihedral_angle_rad(*planes)
        errors.append((angle - (np.pi - np.arccos(a @ b))) / sigma)
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_a_plane_faces_the_camera_and_ignores_outliers() -> None:
    rng = np.random.default_rng(5)
    normal = np.array([0.0, 0.6, -0.8])
    points = face(normal, rng, 1e-4)
    points[:40] += 0.1 * normal
    plane = fit_plane(points, np.arange(400))
    assert plane.offset < 0
    assert 1e-5 < np.degrees(np.arccos(min(1.0, plane.normal @ normal))) < 0.01
    assert np.allclose(plane.residual[:40], 0.1, atol=1e-3)


def test_weights_and_blocks() -> None:
    assert robust_sigma(np.random.default_rng(0).normal(0, 2, 20_000)) == pytest.approx(2, rel=0.03)
    assert biweight(np.array([0.0, 1.0, -1.0, 1.0, 100.0])).tolist()[4] == 0
    assert biweight(np.zeros(3)).tolist() == [1, 1, 1]
    pixel = np.array([[0, 0], [7, 7], [8, 7], [9, 6], [0, 8]])
    assert blocks(pixel, 8).tolist() == [0, 0, 1, 1, 2]
    jacobian, residual = np.ones((4, 1)), np.array([1.0, -1.0, 1.0, -1.0])
    assert np.isinf(robust_covariance(jacobian, residual, np.array([0, 0, 1, 1]))).all()


def test_point_errors_match_their_covariance() -> None:
    scene = room(noise_px=0.1)
    matches = replace(scene.matches, sigma_px=np.full(len(scene.matches), 0.1))[::7]
    error = intersect(matches, scene.calibration).points - scene.points[::7]
    covariance = point_covariances(matches, scene.calibration)
    along = scene.points[::7] / np.linalg.norm(scene.points[::7], axis=1, keepdims=True)
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", along, covariance, along))
    assert 0.9 < np.sqrt(np.mean((np.sum(error * along, axis=1) / sigma) ** 2)) < 1.1
