"""A turntable is found where poses are rotations about one axis, and not elsewhere."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.geometry import Pose
from calib.numerics import Floats
from calib.objects import find_turntable

SIGMA_RAD, SIGMA = 1e-4, 1e-4
MIDDLE = np.array([0.1, -0.05, 3.0])


def places(rng: np.random.Generator, count: int, step_deg: float, tumbling_deg: float) -> tuple[list[Pose], Floats]:
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    point = MIDDLE + 0.2 * rng.standard_normal(3)
    found = [Pose(np.eye(3), np.zeros(3))]
    for k in range(1, count):
        turn = Rotation.from_rotvec(np.radians(step_deg * k) * axis)
        turn = Rotation.from_rotvec(np.radians(tumbling_deg) * rng.standard_normal(3)) * turn
        noise = Rotation.from_rotvec(SIGMA_RAD * rng.standard_normal(3))
        rotation = (noise * turn).as_matrix()
        middle = turn.as_matrix() @ (MIDDLE - point) + point + SIGMA * rng.standard_normal(3)
        found.append(Pose(rotation, middle - rotation @ MIDDLE))
    # The covariance is of where the thing's middle in the common frame is.
    variances = np.tile([SIGMA_RAD**2] * 3 + [1.1 * SIGMA**2] * 3, count)
    variances[:6] = 0.0
    return found, np.diag(variances).astype(np.float64)


@settings(max_examples=15)
@given(st.integers(0, 1000), st.floats(5, 35))
def test_the_axis_is_found_with_its_angles(seed: int, step_deg: float) -> None:
    true, covariance = places(np.random.default_rng(seed), 8, step_deg, 0.0)
    table = find_turntable(true, covariance, np.linalg.pinv(covariance).astype(np.float64), MIDDLE)
    assert table is not None
    found = np.unwrap(table.angles_deg, period=360.0)
    np.testing.assert_allclose(np.abs(found), step_deg * np.arange(8), atol=0.1)
    assert np.all(np.diag(table.covariance)[6:] > 0)
    assert np.trace(table.covariance) < 1.5 * np.trace(covariance)


@settings(max_examples=15)
@given(st.integers(0, 1000))
def test_poses_placed_by_hand_have_no_axis(seed: int) -> None:
    true, covariance = places(np.random.default_rng(seed), 8, 25.0, 1.0)
    assert find_turntable(true, covariance, np.linalg.pinv(covariance).astype(np.float64), MIDDLE) is None
