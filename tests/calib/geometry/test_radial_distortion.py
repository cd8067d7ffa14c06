"""Lens distortion and its inverse match the camera model, with exact derivatives."""

import numpy as np

from calib.geometry.camera import Intrinsics
from calib.geometry.radial_distortion import project, unproject

DEVICE = np.array([1800.0, 1256.0, 1054.0, -0.06, 0.02, 2e-3, -1e-3, 0.01])
BY = np.array([1e-6, 1e-3, 1e-3, *[1e-6] * 5])
STEPS = np.diag([1e-6 * DEVICE[0], *BY[1:]])  # log f moves f in proportion


def _pixels() -> np.ndarray:
    pixels = np.random.default_rng(1).uniform((0, 0), (2448, 2048), (200, 2))
    return np.concatenate([pixels, DEVICE[None, 1:3]])


def test_rays_project_back_to_their_pixels_and_match_the_camera_model() -> None:
    pixels = _pixels()
    rays, _ = unproject(DEVICE, pixels)
    again, _, _ = project(DEVICE, 3.0 * rays)
    np.testing.assert_allclose(again, pixels, atol=1e-9)
    focal, x, y, k1, k2, p1, p2, k3 = DEVICE
    camera = Intrinsics(2448, 2048, (focal, focal), (x, y), (k1, k2, p1, p2, k3))
    np.testing.assert_allclose(rays, camera.unproject(pixels), atol=1e-9)


def test_derivatives_by_the_device_are_exact() -> None:
    pixels = _pixels()
    rays, rays_by_device = unproject(DEVICE, pixels)
    _, _, pixels_by_device = project(DEVICE, rays)
    for column, (step, by) in enumerate(zip(STEPS, BY, strict=True)):
        ahead, behind = DEVICE + step, DEVICE - step
        slope = (unproject(ahead, pixels)[0] - unproject(behind, pixels)[0]) / (2 * by)
        np.testing.assert_allclose(rays_by_device[:, :, column], slope, rtol=1e-5, atol=1e-7)
        slope = (project(ahead, rays)[0] - project(behind, rays)[0]) / (2 * by)
        np.testing.assert_allclose(pixels_by_device[:, :, column], slope, rtol=1e-5, atol=1e-4)


def test_derivatives_by_the_point_are_exact() -> None:
    points = np.random.default_rng(2).normal((0.0, 0.0, 3.0), (0.8, 0.8, 0.4), (100, 3))
    _, by_point, _ = project(DEVICE, points)
    for column, step in enumerate(1e-6 * np.eye(3)):
        slope = (project(DEVICE, points + step)[0] - project(DEVICE, points - step)[0]) / 2e-6
        np.testing.assert_allclose(by_point[:, :, column], slope, rtol=1e-5, atol=1e-3)
