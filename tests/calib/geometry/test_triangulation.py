from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.geometry import Pose
from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.geometry.matches import Matches
from calib.geometry.triangulation import depths_on_stripes, intersect, intersect_rays
from calib.numerics import Floats
from calib.synthetic import look_at

CAMERA = Intrinsics(1200, 900, (1000.0, 1010.0), (590.0, 455.0))
PROJECTOR = Intrinsics(800, 600, (900.0, 880.0), (405.0, 590.0))
BENT = (-0.08, 0.03, 0.0, 0.0, 0.01)
SKEWED = (-0.05, 0.01, 0.002, -0.001, 0.005)
LENSES = {
    "none": (CAMERA, PROJECTOR),
    "radial": (replace(CAMERA, distortion=BENT), replace(PROJECTOR, distortion=BENT)),
    "with tangential terms": (replace(CAMERA, distortion=SKEWED), replace(PROJECTOR, distortion=SKEWED)),
}
NOISE_PX = 0.5


def rig(lens: str) -> Calibration:
    camera, projector = LENSES[lens]
    rotation = look_at(np.array([0.4, 0.1, -0.1]), np.array([0.0, 0.0, 3.0]), np.array([0.0, -1.0, 0.0]), 0.1)
    return Calibration(camera, projector, Pose(rotation, -rotation @ np.array([0.4, 0.1, -0.1])))


def points(count: int, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    return rng.uniform((-1.2, -0.9, 2.4), (1.2, 0.9, 3.6), (count, 3))


def seen(calibration: Calibration, at: Floats) -> tuple[Floats, Floats]:
    moved = calibration.pose @ at
    return calibration.camera.project(at), calibration.projector.project(moved)


# Of few points rays come from Newton's method, of many from a polynomial if the lens has one.
@pytest.mark.parametrize("count", [1, 300, 3000])
@pytest.mark.parametrize("lens", LENSES)
def test_exact_matches_give_back_their_points(lens: str, count: int) -> None:
    calibration, truth = rig(lens), points(count)
    camera_px, projector_px = seen(calibration, truth)
    met = intersect(Matches(camera_px, projector_px), calibration)
    assert met.in_front.all()
    np.testing.assert_allclose(met.points, truth, atol=1e-8)
    np.testing.assert_allclose(met.foot_px, projector_px, atol=1e-6)
    assert np.abs(met.residual_px).max() < 1e-6


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("lens", LENSES)
def test_one_coordinate_of_the_projector_gives_back_depths_and_their_derivatives(lens: str, axis: int) -> None:
    calibration, truth = rig(lens), points(500)
    camera_px, projector_px = seen(calibration, truth)
    ideal = np.ascontiguousarray(calibration.camera.ideal(camera_px).T)
    depth, per_px = depths_on_stripes(ideal, projector_px[:, axis], axis, calibration)
    np.testing.assert_allclose(depth, truth[:, 2], rtol=1e-5)
    step_px = 1e-3
    beyond, before = (
        depths_on_stripes(ideal, projector_px[:, axis] + by, axis, calibration)[0] for by in (step_px, -step_px)
    )
    steep = np.abs(per_px) < 1.0  # metres per pixel: of the others the depth is hardly told
    assert np.count_nonzero(steep) > 450
    np.testing.assert_allclose(((beyond - before) / (2 * step_px))[steep], per_px[steep], rtol=0.01)


def test_a_stripe_of_light_behind_the_camera_is_met_nowhere() -> None:
    calibration = rig("none")
    ideal = np.array([[0.0], [0.0]])
    column = seen(calibration, np.array([[0.0, 0.0, 3.0]]))[1][:, 0]
    far_px = seen(calibration, np.array([[0.0, 0.0, 1e9]]))[1][:, 0]
    beyond = far_px + np.sign(far_px - column)  # than what lies at infinity
    assert np.isnan(depths_on_stripes(ideal, beyond, 0, calibration)[0]).all()
    assert np.isfinite(depths_on_stripes(ideal, column, 0, calibration)[0]).all()


@pytest.mark.parametrize("lens", LENSES)
def test_the_residual_is_the_distance_from_the_epipolar_line(lens: str) -> None:
    """The epipolar line is the projector's image of the camera's ray; the foot of the distance is the nearest point in
    space.
    """
    calibration, truth = rig(lens), points(2000)
    camera_px, projector_px = seen(calibration, truth)
    projector_px = projector_px + np.random.default_rng(1).normal(0, NOISE_PX, projector_px.shape)
    met = intersect_rays(camera_px, projector_px, calibration)
    along_ray = truth[:, None] * np.linspace(0.98, 1.02, 2001)[:, None]
    line = calibration.projector.project(calibration.pose @ along_ray)
    distance = np.linalg.norm(line - projector_px[:, None], axis=2).min(axis=1)
    assert 0.7 * NOISE_PX < np.std(met.residual_px) < 1.3 * NOISE_PX
    assert np.abs(np.abs(met.residual_px) - distance).max() < 0.02 * NOISE_PX
    assert np.linalg.norm(line - met.foot_px[:, None], axis=2).min(axis=1).max() < 0.1
    away = np.linalg.norm(met.foot_px - projector_px, axis=1)
    assert np.all(away > np.abs(met.residual_px) - 1e-9)
    assert np.median(away / np.abs(met.residual_px)) < 1.5


def test_the_residual_changes_sign_across_the_line() -> None:
    calibration = rig("radial")
    camera_px, projector_px = seen(calibration, points(50))
    shift = np.array([0.0, 0.2])
    above, below = (intersect_rays(camera_px, projector_px + s * shift, calibration).residual_px for s in (-1, 1))
    assert np.all(above * below < 0)


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), noise_px=st.floats(0.01, 3.0))
def test_the_point_is_midway_between_the_rays(seed: int, noise_px: float) -> None:
    calibration, truth = rig("radial"), points(40, seed)
    camera_px, projector_px = seen(calibration, truth)
    projector_px = projector_px + np.random.default_rng(seed).normal(0, noise_px, projector_px.shape)
    met = intersect_rays(camera_px, projector_px, calibration)
    u = calibration.camera.unproject(camera_px)
    v = calibration.projector.unproject(projector_px) @ calibration.pose.rotation
    from_camera = np.linalg.norm(np.cross(met.points, u), axis=1) / np.linalg.norm(u, axis=1)
    of_projector = met.points - calibration.projector_centre
    from_projector = np.linalg.norm(np.cross(of_projector, v), axis=1) / np.linalg.norm(v, axis=1)
    gap = np.abs(np.sum(calibration.projector_centre * np.cross(u, v), axis=1)) / np.linalg.norm(np.cross(u, v), axis=1)
    np.testing.assert_allclose(from_camera, gap / 2, atol=1e-9)
    np.testing.assert_allclose(from_projector, gap / 2, atol=1e-9)


def test_rays_that_meet_behind_a_device_are_flagged() -> None:
    calibration = rig("none")
    camera_px, projector_px = seen(calibration, points(500))
    backwards = calibration.scaled(-1.0)
    met = intersect_rays(camera_px, projector_px, backwards)
    assert not met.in_front.any()
    assert np.isnan(met.residual_px).all()


def test_parallel_rays_meet_nowhere() -> None:
    camera = replace(CAMERA, focal_px=(1000.0, 1000.0))
    calibration = Calibration(camera, camera, Pose(np.eye(3), np.array([-1.0, 0.0, 0.0])))
    same_px = np.array([[600.0, 400.0], [10.0, 20.0]])
    assert not intersect_rays(same_px, same_px, calibration).in_front.any()


def test_pixels_far_outside_the_image_are_handled() -> None:
    """The polynomial inverse of a lens holds inside the image only."""
    calibration = rig("radial")
    truth = points(3000)
    truth[::100, 0] *= 1.5
    camera_px, projector_px = seen(calibration, truth)
    outside = np.any((camera_px < -2) | (camera_px > (1202, 902)), axis=1)
    met = intersect_rays(camera_px, projector_px, calibration)
    assert 0 < np.count_nonzero(outside) < 100
    np.testing.assert_allclose(met.points, truth, atol=1e-7)


def test_single_precision_and_any_memory_layout_are_accepted() -> None:
    calibration = rig("radial")
    camera_px, projector_px = seen(calibration, points(100))
    met = intersect_rays(camera_px, projector_px, calibration)
    for convert in (np.asfortranarray, lambda a: np.repeat(a, 2, axis=0)[::2], lambda a: a.astype(np.float32)):
        again = intersect_rays(convert(camera_px), convert(projector_px), calibration)
        assert np.abs(again.points - met.points).max() < 1e-4
