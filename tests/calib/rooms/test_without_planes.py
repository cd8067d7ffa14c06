"""Two views of a lump without planes, rotated by 5° in between, with a known rig."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Intrinsics, Matches, Pose
from calib.numerics import Floats
from calib.refinement import State, without_lens
from calib.refusal import RefusalError
from calib.rooms import RigPrior, estimate_without_planes

TURN = Rotation.from_rotvec(np.radians(5.0) * np.array([0.1, -0.97, 0.22]))
CENTRE, RADIUS, NOISE_PX = np.array([0.1, 0.0, 3.5]), 0.8, 0.1
CAMERA, PROJECTOR = (
    Intrinsics(1000, 800, (1500.0, 1500.0), (500.0, 400.0)),
    Intrinsics(800, 600, (1200.0, 1200.0), (400.0, 300.0)),
)
RIG = Calibration(
    CAMERA, PROJECTOR, Pose(Rotation.from_euler("y", 14, degrees=True).as_matrix(), np.array([-0.995, 0.02, 0.098]))
)
STATE = State(
    without_lens(1500.0, np.array([500.0, 400.0])),
    without_lens(1200.0, np.array([400.0, 300.0])),
    RIG.pose.in_baselines,
)


def lump(rng: np.random.Generator, count: int) -> Floats:
    """Points (count, 3) on the camera side of a bumpy ball about the origin."""
    way = rng.standard_normal((count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    way[:, 2] = -np.abs(way[:, 2])
    x, y, z = way.T
    return way * (RADIUS * (1 + 0.08 * np.sin(5 * x + 1) * np.cos(4 * y) + 0.06 * np.sin(7 * z - 3 * x)))[:, None]


def seen(points: Floats, rng: np.random.Generator) -> Matches:
    camera_px = CAMERA.project(points)
    projector_px = PROJECTOR.project(STATE.pose @ points)
    noise = NOISE_PX * rng.standard_normal(projector_px.shape)
    return Matches(camera_px, projector_px + noise, None, np.full(len(points), NOISE_PX))


def test_the_rotation_is_recovered_with_a_true_sigma() -> None:
    rng = np.random.default_rng(1)
    stations = [
        seen(lump(rng, 30_000) + CENTRE, rng),
        seen(lump(rng, 30_000) @ TURN.as_matrix().T + CENTRE, rng),
    ]
    place = Pose(TURN.as_matrix().T, CENTRE - TURN.as_matrix().T @ CENTRE)
    off = Rotation.from_rotvec(np.radians([0.2, -0.15, 0.1])).as_matrix()
    start = Pose(off @ place.rotation, off @ place.translation + 0.004)
    still = Pose(np.eye(3), np.zeros(3))
    found = estimate_without_planes(stations, [still, start], STATE, RigPrior.exactly(STATE))
    turned = Rotation.from_matrix(found.room.places[1].rotation @ place.rotation.T)
    sigma = np.sqrt(np.diag(found.place_covariance(1)))
    assert 0 < np.degrees(turned.magnitude()) < 0.02
    assert np.all(np.abs(turned.as_rotvec()) < 4 * sigma[:3])
    assert np.all(sigma[:3] < np.radians(0.02))
    np.testing.assert_array_equal(found.room.rig.camera, STATE.camera)


def test_surfaces_that_are_apart_are_refused() -> None:
    rng = np.random.default_rng(2)
    stations = [seen(lump(rng, 5000) + CENTRE, rng), seen(lump(rng, 5000) + CENTRE, rng)]
    apart = Pose(np.eye(3), np.array([5.0, 0.0, 0.0]))
    with pytest.raises(RefusalError, match="too far apart"):
        estimate_without_planes(stations, [Pose(np.eye(3), np.zeros(3)), apart], STATE, RigPrior.exactly(STATE))
