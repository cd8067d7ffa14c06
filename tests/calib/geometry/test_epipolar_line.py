"""One coordinate and the epipolar line give the other, checked with points that both devices see."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from calib.geometry import Pose
from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.geometry.epipolar_line import cross_epipolar_lines
from calib.numerics import Floats
from calib.synthetic import look_at

BENT = (-0.25, 0.08, 0.002, -0.001, 0.0)
CAMERA = Intrinsics(1200, 900, (1000.0, 1010.0), (590.0, 455.0))
PROJECTOR = Intrinsics(800, 600, (900.0, 880.0), (405.0, 590.0))
UP = np.array([0.0, -1.0, 0.0])
# Aside and up, so that neither axis runs along the epipolar lines; in z too, so that they are no parallels.
CENTRE = np.array([0.35, 0.3, -0.1])


def rig(centre: Floats = CENTRE, *, bent: bool = True, roll: float = 0.1) -> Calibration:
    camera, projector = (replace(device, distortion=BENT) if bent else device for device in (CAMERA, PROJECTOR))
    rotation = look_at(centre, np.array([0.0, 0.0, 3.0]), UP, roll)
    return Calibration(camera, projector, Pose(rotation, -rotation @ centre))


def seen(calibration: Calibration, points: Floats) -> tuple[Floats, Floats]:
    return calibration.camera.project(points), calibration.projector.project(calibration.pose @ points)


def room(count: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).uniform((-0.9, -0.7, 2.2), (0.9, 0.7, 4.0), (count, 3))


@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("count", [1, 3000])  # few rays come from Newton's method, many from a polynomial
def test_the_other_coordinate_is_recovered(axis: int, bent: bool, count: int) -> None:
    calibration = rig(bent=bent)
    camera_px, projector_px = seen(calibration, room(count))
    found = cross_epipolar_lines(camera_px, projector_px[:, axis], axis, calibration)
    assert found.in_front.all()
    np.testing.assert_allclose(found.projector_px, projector_px, atol=1e-5)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_sine_gives_the_error_amplification(axis: int) -> None:
    calibration, step = rig(), 1e-3
    camera_px, projector_px = seen(calibration, room(500))
    here, beside = (
        cross_epipolar_lines(camera_px, projector_px[:, axis] + error, axis, calibration) for error in (0.0, step)
    )
    moved = np.linalg.norm(beside.projector_px - here.projector_px, axis=1)
    np.testing.assert_allclose(moved, step / here.sine, rtol=1e-2)
    assert np.ptp(here.sine) > 0.05


def test_stripes_along_the_epipolar_lines_have_zero_sine() -> None:
    """Side by side, devices have epipolar lines along the rows: y gives no depth, x all of it."""
    rotation, centre = np.eye(3), np.array([0.4, 0.0, 0.0])
    calibration = Calibration(CAMERA, PROJECTOR, Pose(rotation, -rotation @ centre))
    camera_px, projector_px = seen(calibration, room(200))
    x, y = (cross_epipolar_lines(camera_px, projector_px[:, axis], axis, calibration) for axis in (0, 1))
    np.testing.assert_allclose(x.sine, 1.0, atol=1e-9)
    np.testing.assert_allclose(y.sine, 0.0, atol=1e-9)


def test_points_behind_a_device_are_flagged() -> None:
    calibration = rig(bent=False)
    camera_px, projector_px = seen(calibration, room(300))
    turned = calibration.scaled(-1.0)
    found = cross_epipolar_lines(camera_px, projector_px[:, 0], 0, turned)
    assert not found.in_front.any()


@settings(max_examples=40)
@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-0.5, 0.5), st.floats(-0.6, 0.6), st.sampled_from([0, 1]))
def test_the_other_coordinate_is_recovered_for_every_pose(x: float, y: float, z: float, roll: float, axis: int) -> None:
    """For any point in the projector's image whose epipolar line is not parallel to the stripe."""
    centre = np.array([x, y, z])
    assume(np.linalg.norm(centre) > 0.05)
    calibration = rig(centre, roll=roll)
    camera_px, projector_px = seen(calibration, room(50))
    _, behind_it = seen(calibration, 1.0001 * room(50))
    line = behind_it - projector_px
    inside = np.all((projector_px >= 0) & (projector_px < (PROJECTOR.width, PROJECTOR.height)), axis=1)
    well = inside & (np.abs(line[:, axis]) > 0.1 * np.linalg.norm(line, axis=1))
    found = cross_epipolar_lines(camera_px[well], projector_px[well, axis], axis, calibration)
    assert found.in_front.all()
    np.testing.assert_allclose(found.projector_px, projector_px[well], atol=1e-4)
