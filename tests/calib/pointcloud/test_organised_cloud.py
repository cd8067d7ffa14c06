"""Where windows hold too few points, neighbours within a window's width decide."""

from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calib.geometry import Matches
from calib.pointcloud import surface
from calib.pointcloud.organised_cloud import Cloud, _neighbour_planes, build_cloud
from scanner.capture import open_capture
from scanner.decoding import Decoder
from scanner.io import read_calibration
from tests.support.cloud_scene import CAMERA, SPHERE_RADIUS_M, Scene, room, with_mistakes
from tests.support.places import REAL_CAPTURES

SLTK = REAL_CAPTURES / "sltk-scan0020"
FOCAL_PX = 500.0
WINDOW = 7  # the smallest, which smooth surfaces get


@pytest.fixture(scope="module")
def scene() -> Scene:
    return room()


@pytest.fixture(scope="module")
def cloud(scene: Scene) -> Cloud:
    return cloud_of(scene)


def cloud_of(scene: Scene) -> Cloud:
    return build_cloud(scene.matches, scene.texture, scene.calibration)


Number = TypeVar("Number", bound=np.generic)


def at_matches(grid: NDArray[Number], scene: Scene) -> NDArray[Number]:
    column, row = np.rint(scene.matches.camera_px).astype(int).T
    return grid[row, column]


def angles_deg(normals: NDArray[np.float32], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.degrees(np.arccos(np.clip(np.sum(normals * truth, axis=1), -1, 1)))


def test_points_and_normals_against_the_truth(scene: Scene, cloud: Cloud) -> None:
    error_m = np.linalg.norm(at_matches(cloud.points, scene) - scene.points, axis=1)
    assert 1e-4 < np.median(error_m) < 4e-4
    assert np.percentile(error_m, 99) < 1.5e-3
    off = angles_deg(at_matches(cloud.normals, scene), scene.normals)
    assert 0.1 < np.median(off) < 0.5
    assert np.percentile(off[scene.surface < 3], 90) < 2


def test_the_sphere_has_its_radius(scene: Scene, cloud: Cloud) -> None:
    on_sphere = at_matches(cloud.points, scene)[scene.surface == 3].astype(np.float64)
    design = np.column_stack([2 * on_sphere, np.ones(len(on_sphere))])
    x, y, z, rest = np.linalg.lstsq(design, np.sum(on_sphere**2, axis=1), rcond=None)[0]
    radius_m = np.sqrt(rest + x * x + y * y + z * z)
    assert 1e-7 < abs(radius_m - SPHERE_RADIUS_M) < 5e-4


def test_every_point_has_a_unit_normal_that_faces_the_camera(cloud: Cloud) -> None:
    points, normals = cloud.points[cloud.there], cloud.normals[cloud.there]
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5
    assert np.sum(normals * points, axis=1).max() < 0
    assert np.isnan(cloud.normals[~cloud.there]).all()


def test_normals_do_not_bridge_occlusion_edges(scene: Scene, cloud: Cloud) -> None:
    silhouette = cKDTree(scene.matches.camera_px[scene.surface == 3])
    near_sphere = silhouette.query(scene.matches.camera_px)[0] < 3
    behind = near_sphere & (np.linalg.norm(scene.points - scene.sphere_centre, axis=1) > 2 * SPHERE_RADIUS_M)
    assert behind.sum() > 100
    off = angles_deg(at_matches(cloud.normals, scene)[behind], scene.normals[behind])
    assert 0.1 < np.median(off) < 3
    assert np.percentile(off, 95) < 20


def test_decoder_errors_are_dropped(scene: Scene) -> None:
    spoiled, wrong = with_mistakes(scene, 0.1)
    cloud = cloud_of(spoiled)
    kept = at_matches(cloud.there, spoiled)
    error_m = np.linalg.norm(at_matches(cloud.points, spoiled) - scene.points, axis=1)
    assert kept[~wrong].mean() > 0.999
    assert np.sum(kept[wrong] & (error_m[wrong] > 0.01)) < 0.003 * wrong.sum()
    assert 0.9 * wrong.sum() < cloud.statistics.disagreeing <= wrong.sum()


def test_the_limit_follows_the_noise() -> None:
    fine, coarse = (cloud_of(room(noise_px=noise_px)).statistics for noise_px in (0.05, 0.29))
    assert fine.limit_px == 1.0
    assert 0.045 < fine.decoder_px < 0.055
    assert 1.6 < coarse.limit_px < 1.9
    assert 0.27 < coarse.decoder_px < 0.31
    assert fine.disagreeing == coarse.disagreeing == 0


def test_an_unmodelled_lens_costs_no_points(scene: Scene) -> None:
    ideal = replace(scene.calibration, camera=replace(CAMERA, distortion=(0.0,) * 5))
    cloud = build_cloud(scene.matches, scene.texture, ideal)
    assert np.percentile(np.abs(cloud.residual_px[np.isfinite(cloud.residual_px)]), 95) > 1.5
    assert cloud.statistics.calibration_px > 0.5
    assert cloud.statistics.disagreeing < 0.002 * len(scene.matches)


def test_flying_points_are_dropped_though_their_rays_agree(scene: Scene) -> None:
    nearer = 0.8 * scene.points
    in_mid_air = cKDTree(scene.points).query(nearer)[0] > 0.12
    flying = np.zeros(len(scene.matches), dtype=bool)
    flying[np.random.default_rng(2).permutation(np.flatnonzero(in_mid_air))[:200]] = True
    moved = scene.matches.projector_px.copy()
    moved[flying] = scene.calibration.projector.project(scene.calibration.pose @ nearer[flying])
    spoiled = replace(scene, matches=replace(scene.matches, projector_px=moved))
    cloud = cloud_of(spoiled)
    kept = at_matches(cloud.there, spoiled)
    assert cloud.statistics.disagreeing == 0
    assert flying.sum() == 200
    assert kept[flying].sum() <= 2
    assert kept[~flying].mean() > 0.9995


def test_one_match_per_projector_pixel_still_gets_normals(scene: Scene) -> None:
    """Plain Gray codes: sparse on the grid, between pixels."""
    rng = np.random.default_rng(3)
    few = rng.random(len(scene.matches)) < 0.06
    thin = replace(
        scene,
        matches=Matches(scene.matches.camera_px[few], scene.matches.projector_px[few]),
        normals=scene.normals[few],
        surface=scene.surface[few],
    )
    cloud = cloud_of(thin)
    assert cloud.statistics.kept > 0.98 * few.sum()
    kept = at_matches(cloud.there, thin)
    off = angles_deg(at_matches(cloud.normals, thin)[kept], thin.normals[kept])
    assert np.isfinite(cloud.normals[cloud.there]).all()
    assert 0.05 < np.median(off[thin.surface[kept] < 3]) < 2


@pytest.mark.parametrize("count", [1, 4, 250])
def test_a_few_matches_give_a_cloud(scene: Scene, count: int) -> None:
    few = np.random.default_rng(4).permutation(len(scene.matches))[:count]
    statistics = build_cloud(scene.matches[few], scene.texture, scene.calibration).statistics
    assert statistics.disagreeing == 0
    assert statistics.kept + statistics.isolated == count
    assert statistics.kept > 0.9 * count if count > 4 else statistics.kept == 0


def test_every_match_is_accounted_for(scene: Scene) -> None:
    spoiled, _ = with_mistakes(scene, 0.05)
    m = spoiled.matches
    doubled = Matches(
        np.concatenate([m.camera_px, m.camera_px[:500] + 0.3, [[-3.0, 5.0], [9.0, 1e4]]]),
        np.concatenate([m.projector_px, m.projector_px[:500] + 0.4, [[1.0, 1.0], [1.0, 1.0]]]),
    )
    statistics = build_cloud(doubled, scene.texture, scene.calibration).statistics
    assert statistics.matched == len(m) + 502
    assert statistics.outside_image == 2
    assert 400 < statistics.shared_pixel < 500
    dropped = (
        statistics.outside_image,
        statistics.behind,
        statistics.disagreeing,
        statistics.shared_pixel,
        statistics.isolated,
    )
    assert statistics.kept + sum(dropped) == statistics.matched


def test_the_better_of_two_matches_at_a_pixel_is_kept(scene: Scene, cloud: Cloud) -> None:
    m = scene.matches
    worse = Matches(np.tile(m.camera_px, (2, 1)), np.concatenate([m.projector_px + 0.6, m.projector_px]))
    both = build_cloud(worse, scene.texture, scene.calibration)
    first, second = np.abs(both.residual_px[both.there]), np.abs(cloud.residual_px[cloud.there])
    assert both.statistics.kept == both.statistics.shared_pixel == len(m)
    assert np.median(np.linalg.norm(both.points[both.there] - cloud.points[cloud.there], axis=1)) < 1e-6
    assert first.shape == second.shape


def test_points_behind_the_devices_are_dropped(scene: Scene) -> None:
    backwards = scene.calibration.scaled(-1.0)
    cloud = build_cloud(scene.matches, scene.texture, backwards)
    assert cloud.statistics.behind > 0.9 * len(scene.matches)
    assert cloud.statistics.kept == cloud.there.sum() < 0.1 * len(scene.matches)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_unit_does_not_matter(scene: Scene, cloud: Cloud, factor: float) -> None:
    calibration = scene.calibration.scaled(factor, "other")
    other = build_cloud(scene.matches, scene.texture, calibration)
    assert other.unit == "other"
    assert np.array_equal(other.there, cloud.there)
    assert np.abs(other.points[other.there] / factor - cloud.points[cloud.there]).max() < 1e-4
    assert np.abs(other.normals[other.there] - cloud.normals[cloud.there]).max() < 1e-2


def test_colours_come_from_the_texture(scene: Scene) -> None:
    grey = scene.texture[..., 1]
    there = cloud_of(scene).there
    rgb, of_grey, deep, none = (
        build_cloud(scene.matches, texture, scene.calibration).colours
        for texture in (scene.texture, grey, scene.texture.astype(np.uint16) * 100, None)
    )
    assert np.array_equal(rgb[there], scene.texture[there][:, ::-1])
    assert np.array_equal(of_grey[there], np.repeat(grey[there][:, None], 3, axis=1))
    brightest = np.percentile(scene.texture[there], 99.9)
    assert np.abs(deep[there] - np.minimum(255, rgb[there] * 255.0 / brightest)).max() <= 1
    assert len(np.unique(none[there])) == 1
    assert not rgb[~there].any()


def test_no_matches_give_an_empty_cloud(scene: Scene) -> None:
    cloud = build_cloud(Matches(np.zeros((0, 2)), np.zeros((0, 2))), scene.texture, scene.calibration)
    assert cloud.statistics.kept == cloud.statistics.matched == 0
    assert not cloud.there.any()


def test_a_texture_of_another_size_is_an_error(scene: Scene) -> None:
    with pytest.raises(ValueError, match="408 × 342, found 408 × 341"):
        build_cloud(scene.matches, scene.texture[1:], scene.calibration)


@pytest.mark.skipif(not SLTK.exists(), reason="the real captures in shared/data are not there")
def test_a_real_capture_lies_on_its_reference() -> None:
    """The reference has one point per 0.38 mm; an independent decoder reached 0.012 mm (see the README of the data)."""
    stream = open_capture(SLTK).stream()
    decoder = Decoder(stream.patterns, stream.projector_size)
    for _, frame in stream.frames:
        decoder.add(frame.image)
    decoding = decoder.finish()
    cloud = build_cloud(decoding.matches, decoding.texture, read_calibration(SLTK / "calibration.yaml"))
    distance = cKDTree(sltk_reference()).query(cloud.points[cloud.there])[0]
    assert 0.001 < np.median(distance) < 0.02
    assert np.percentile(distance, 95) < 0.45
    assert cloud.statistics.kept > 0.98 * len(decoding.matches)
    assert cloud.statistics.disagreeing < 0.005 * len(decoding.matches)


def sltk_reference() -> NDArray[np.float64]:
    content = (SLTK / "reference.ply").read_bytes()
    body = content[content.index(b"end_header\n") + len(b"end_header\n") :]
    vertices = np.frombuffer(body, dtype=[("at", "<f4", 3), ("colour", "u1", 3)])
    return vertices["at"].astype(np.float64) * (1, -1, -1)


def wall_and_lone_point(apart: int) -> NDArray[np.float32]:
    """A slanted wall, and one more point of it `apart` px to the right of its edge."""
    y, x = np.mgrid[:80, :120].astype(np.float64)
    inverse = 0.5 + 0.1 * (x - 60) / FOCAL_PX
    points = np.stack([(x - 60) / FOCAL_PX, (y - 40) / FOCAL_PX, np.ones_like(x)], axis=-1) / inverse[..., None]
    kept = x < 60
    kept[40, 59 + apart] = True
    points[~kept] = np.nan
    return points.astype(np.float32)


@pytest.mark.parametrize(("apart", "isolated"), [(WINDOW - 2, False), (WINDOW, False), (WINDOW + 1, True)])
def test_a_point_beside_a_wall_belongs_to_it_within_a_window(apart: int, isolated: bool) -> None:
    points = wall_and_lone_point(apart)
    normals = surface(points, FOCAL_PX)
    assert bool(normals.isolated[40, 59 + apart]) == isolated
    assert np.count_nonzero(normals.isolated) == isolated
    if not isolated:
        expected = -np.array([0.1, 0.0, 0.5]) / np.hypot(0.1, 0.5)
        np.testing.assert_allclose(normals.normals[40, 59 + apart], expected, atol=2e-3)


def test_a_point_with_nan_reach_is_isolated_and_faces_the_camera() -> None:
    """As with extreme lens distortion."""
    points = np.random.default_rng(0).normal((0, 0, 5), 0.1, (20, 3)).astype(np.float32)
    normals, isolated = _neighbour_planes(points, points, np.full(20, -1.0))
    assert isolated.all()
    np.testing.assert_allclose(normals, -points / np.linalg.norm(points, axis=1, keepdims=True), rtol=1e-5)
