"""A ball is found at its place, and nowhere else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.geometry import Intrinsics, intersect
from calib.pointcloud.pixel_grid import NONE, density, index_grid, without_gaps
from calib.pointcloud.sphere_fit import OrganisedPoints, find_sphere
from tests.support.cloud_scene import CAMERA, SPHERE_RADIUS_M, Scene, room, with_mistakes


def organised(scene: Scene) -> OrganisedPoints:
    camera = scene.calibration.camera
    index = np.full((camera.height, camera.width), -1)
    column, row = scene.matches.camera_px.astype(int).T
    index[row, column] = np.arange(len(scene.matches))
    return OrganisedPoints(intersect(scene.matches, scene.calibration).points, index, camera)


def find(scene: Scene, radius: float, seed: int = 0, without_ball: bool = False) -> np.ndarray | None:
    free = (scene.surface != 3) if without_ball else np.ones(len(scene.matches), bool)
    return find_sphere(organised(scene), radius, free, np.random.default_rng(seed))


SMALL = Intrinsics(136, 114, (99.7, 99.7), (69.3, 58.3))


@pytest.mark.parametrize(("camera", "noise_px"), [(CAMERA, 0.0), (CAMERA, 0.05), (CAMERA, 0.5), (SMALL, 0.05)], ids=str)
def test_the_ball_is_found(camera: Intrinsics, noise_px: float) -> None:
    scene = room(camera, noise_px=noise_px)
    for seed in range(3):
        centre = find(scene, SPHERE_RADIUS_M, seed)
        assert centre is not None
        assert np.linalg.norm(centre - scene.sphere_centre) < 0.1 * SPHERE_RADIUS_M


@pytest.mark.parametrize("error", [0.93, 1.07])
def test_the_ball_is_found_although_the_scale_is_wrong(error: float) -> None:
    scene = room()
    centre = find(scene, error * SPHERE_RADIUS_M)
    assert centre is not None
    assert 1e-6 < np.linalg.norm(centre - scene.sphere_centre) < 0.2 * SPHERE_RADIUS_M


def test_the_ball_is_found_among_wrong_matches() -> None:
    scene, wrong = with_mistakes(room(), 0.1)
    assert wrong.mean() > 0.09
    centre = find(scene, SPHERE_RADIUS_M)
    assert centre is not None
    assert 1e-6 < np.linalg.norm(centre - scene.sphere_centre) < 0.1 * SPHERE_RADIUS_M


@pytest.mark.parametrize("radius", [0.05, 0.08, 0.1, 0.15, 0.22, 0.3, 0.5, 1.0])
def test_a_corner_without_a_ball_has_none(radius: float) -> None:
    assert find(room(), radius, without_ball=True) is None


@pytest.mark.parametrize("radius", [0.004, 0.05, 0.2, 0.3])
def test_a_ball_of_another_size_is_not_found(radius: float) -> None:
    assert find(room(), radius) is None


@pytest.mark.parametrize("share", [0.5, 0.11, 0.05])
def test_the_ball_is_found_among_sparse_points(share: float) -> None:
    scene = room()
    free = np.random.default_rng(0).random(len(scene.matches)) < share
    centre = find_sphere(organised(scene), SPHERE_RADIUS_M, free, np.random.default_rng(0))
    assert centre is not None
    assert 1e-6 < np.linalg.norm(centre - scene.sphere_centre) < 0.1 * SPHERE_RADIUS_M
    assert find_sphere(organised(scene), SPHERE_RADIUS_M, free & (scene.surface != 3), np.random.default_rng(0)) is None


def test_gaps_are_closed_and_holes_are_not() -> None:
    pixel = np.stack(np.meshgrid(np.arange(0, 90, 3), np.arange(0, 60, 3)), axis=-1).reshape(-1, 2)
    pixel = pixel[np.abs(pixel - (45, 30)).max(axis=1) > 12]
    sparse = index_grid(pixel, (90, 60))
    assert density(sparse) == pytest.approx(1 / 9, rel=0.15)
    filled = without_gaps(sparse)
    assert filled[30, 45] == NONE
    assert np.count_nonzero(filled == NONE) < 25**2
    row, column = np.nonzero(filled != NONE)
    assert np.abs(pixel[filled[row, column]] - np.stack([column, row], axis=1)).max() <= 5
    assert np.array_equal(filled[sparse != NONE], sparse[sparse != NONE])
    whole = index_grid(np.stack(np.meshgrid(np.arange(40), np.arange(30)), -1).reshape(-1, 2), (40, 30))
    assert np.array_equal(without_gaps(whole), whole)


def test_without_points_no_ball_is_found() -> None:
    scene = room()
    nothing = np.zeros(len(scene.matches), bool)
    assert find_sphere(organised(scene), 0.15, nothing, np.random.default_rng(0)) is None


def test_a_concave_sphere_is_not_found(tmp_path: Path) -> None:
    """Points on the far side of a sphere, as in a bowl, curve away from the camera."""
    scene = room()
    cloud = organised(scene)
    from_centre = cloud.points - scene.sphere_centre
    ray = cloud.points / np.linalg.norm(cloud.points, axis=1, keepdims=True)
    deeper = cloud.points - 2 * np.sum(from_centre * ray, axis=1)[:, None] * ray
    hollow = replace(cloud, points=np.where((scene.surface == 3)[:, None], deeper, cloud.points))
    assert np.allclose(
        np.linalg.norm((hollow.points - scene.sphere_centre)[scene.surface == 3], axis=1), 0.15, atol=0.01
    )
    assert find_sphere(hollow, SPHERE_RADIUS_M, np.ones(len(scene.matches), bool), np.random.default_rng(0)) is None
