"""Rotation vectors, tangents of directions, and steps between motions."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.geometry.relative_pose import Motion, rotation_about, tangent_basis

NUMBERS = st.floats(-2.0, 2.0)
VECTORS = st.tuples(NUMBERS, NUMBERS, NUMBERS).map(np.array)
DIRECTIONS = VECTORS.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))


@given(VECTORS, st.sampled_from([1.0, 1e-6, 1e-9, 0.0]))
def test_rotations_match_scipy(vector: np.ndarray, scale: float) -> None:
    expected = Rotation.from_rotvec(scale * vector).as_matrix()
    np.testing.assert_allclose(rotation_about(scale * vector), expected, atol=1e-14)


@given(DIRECTIONS)
def test_a_direction_and_its_tangents_are_a_frame(direction: np.ndarray) -> None:
    frame = np.column_stack([tangent_basis(direction), direction])
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)


@given(DIRECTIONS, st.floats(0.3, 3.0))
def test_step_to_recovers_a_small_step(direction: np.ndarray, length: float) -> None:
    start = Motion(rotation_about(np.array([0.3, -0.2, 0.5])), length * direction)
    step = 1e-5 * np.array([1.0, -2.0, 0.5, 0.7, -0.3, 1.5])
    np.testing.assert_allclose(start.step_to(start.moved(step)), step, atol=1e-9)
    assert abs(start.moved(step[:5]).length - length) < 1e-12
