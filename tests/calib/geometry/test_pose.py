"""Poses: the axioms of SE(3) over batches, its exponential, the adjoint, steps; rotation vectors and tangents."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from calib.geometry.pose import (
    IDENTITY,
    Pose,
    cross_matrix,
    nearest_rotation,
    rotation_about,
    rotation_vector,
    tangent_basis,
)
from calib.numerics import Floats

NUMBERS = st.floats(-2.0, 2.0)
VECTORS = st.tuples(NUMBERS, NUMBERS, NUMBERS).map(np.array)
DIRECTIONS = VECTORS.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v))
SCALES = st.sampled_from([1.0, 0.1, 1e-3, 1e-6, 1e-9, 0.0])
BATCH = 4
BATCHES = arrays(np.float64, (BATCH, 6), elements=NUMBERS)
CLOUDS = arrays(np.float64, (BATCH, 5, 3), elements=st.floats(-10.0, 10.0))


def poses_of(vectors: Floats) -> Pose:
    """A batch of poses by SciPy's rotations, from rotation vectors and translations (..., 6)."""
    rotations = Rotation.from_rotvec(vectors[..., :3].reshape(-1, 3)).as_matrix()
    return Pose(rotations.reshape(*vectors.shape[:-1], 3, 3), vectors[..., 3:])


def assert_same(first: Pose, second: Pose, atol: float = 1e-12) -> None:
    np.testing.assert_allclose(first.rotation, second.rotation, atol=atol)
    np.testing.assert_allclose(first.translation, second.translation, atol=atol)


@given(BATCHES, BATCHES, BATCHES, CLOUDS)
def test_composition_is_associative_and_moves_points_in_turn(a: Floats, b: Floats, c: Floats, points: Floats) -> None:
    first, second, third = poses_of(a), poses_of(b), poses_of(c)
    assert_same((first @ second) @ third, first @ (second @ third))
    np.testing.assert_allclose((first @ second) @ points, first @ (second @ points), atol=1e-12)


@given(BATCHES, CLOUDS)
def test_the_inverse_undoes_a_pose_on_both_sides(vectors: Floats, points: Floats) -> None:
    poses = poses_of(vectors)
    for there_and_back in (poses @ poses.inverse(), poses.inverse() @ poses):
        assert_same(there_and_back, Pose.stack([IDENTITY] * BATCH))
    np.testing.assert_allclose(poses.inverse() @ (poses @ points), points, atol=1e-12)
    np.testing.assert_allclose(poses[0].undo(poses[0] @ points), points, atol=1e-12)


@given(BATCHES, CLOUDS)
def test_a_batch_does_what_its_poses_do_one_by_one(vectors: Floats, points: Floats) -> None:
    batch = poses_of(vectors)
    inverse, product, cloud = batch.inverse(), batch @ batch[::-1], batch @ points[0]
    for k in range(BATCH):
        pose = batch[k]
        np.testing.assert_allclose(pose @ points[0, 0], pose.rotation @ points[0, 0] + pose.translation, atol=1e-12)
        np.testing.assert_allclose(cloud[k], points[0] @ pose.rotation.T + pose.translation, atol=1e-12)
        np.testing.assert_allclose(batch.rotate(points)[k], points[k] @ pose.rotation.T, atol=1e-12)
        assert_same(inverse[k], pose.inverse(), 1e-14)
        assert_same(product[k], pose @ batch[BATCH - 1 - k], 1e-14)
        np.testing.assert_allclose(batch.adjoint[k], pose.adjoint, atol=1e-14)
        np.testing.assert_allclose(batch.log()[k], pose.log(), atol=1e-9)
        np.testing.assert_allclose(batch.matrix[k], np.vstack([np.c_[pose.rotation, pose.translation], [0, 0, 0, 1]]))
    assert_same(Pose.stack([batch[k] for k in range(BATCH)]), batch, 0)
    assert_same(Pose.concatenate([batch[:1], batch[1:]]), batch, 0)
    assert_same(batch[np.arange(BATCH) > 1], batch[2:], 0)
    assert batch[0][None].rotation.shape == (1, 3, 3)


@given(BATCHES, SCALES)
def test_exp_is_the_exponential_of_the_matrix_of_a_twist(twists: Floats, scale: float) -> None:
    poses = Pose.exp(scale * twists)
    for twist, matrix in zip(scale * twists, poses.matrix, strict=True):
        generator = np.zeros((4, 4))
        generator[:3, :3], generator[:3, 3] = cross_matrix(twist[:3]), twist[3:]
        np.testing.assert_allclose(matrix, expm(generator), atol=1e-13)


@given(BATCHES, SCALES)
def test_log_is_the_inverse_of_exp(twists: Floats, scale: float) -> None:
    turns = np.linalg.norm(twists[:, :3], axis=1, keepdims=True)
    twists = twists * np.minimum(1.0, 3.1 / np.maximum(turns, 1e-300))  # beyond π it is another twist
    np.testing.assert_allclose(Pose.exp(scale * twists).log(), scale * twists, atol=1e-13, rtol=1e-12)


@given(DIRECTIONS, VECTORS, st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1]))
def test_exp_is_the_inverse_of_log_up_to_half_a_turn(axis: Floats, shift: Floats, short_of_pi: float) -> None:
    pose = Pose(Rotation.from_rotvec((np.pi - short_of_pi) * axis).as_matrix(), shift)
    assert_same(Pose.exp(pose.log()), pose, 1e-12)
    np.testing.assert_allclose(pose.angle, np.pi - short_of_pi, atol=1e-9)


@given(BATCHES, BATCHES)
def test_the_adjoint_carries_twists_to_the_other_frame(vectors: Floats, twists: Floats) -> None:
    poses = poses_of(vectors)
    carried = (poses.adjoint @ twists[..., None])[..., 0]
    assert_same(poses @ Pose.exp(twists), Pose.exp(carried) @ poses, 1e-11)
    np.testing.assert_allclose((poses @ poses[::-1]).adjoint, poses.adjoint @ poses[::-1].adjoint, atol=1e-11)


@given(BATCHES, BATCHES)
def test_relative_poses_do_not_depend_on_the_gauge(vectors: Floats, gauge: Floats) -> None:
    """A common motion of the frame that all are posed in changes no pose of one in another's."""
    poses, frame = poses_of(vectors), poses_of(gauge[0])
    moved = Pose.stack([frame @ poses[k] for k in range(BATCH)])
    assert_same(moved[:1].inverse() @ moved, poses[:1].inverse() @ poses, 1e-11)


@given(BATCHES, st.floats(0.3, 3.0))
def test_steps_lead_to_nearby_poses_and_are_found_again(vectors: Floats, unit: float) -> None:
    start, step = poses_of(vectors[0]), 1e-3 * vectors[1]
    moved = start.retract(step, unit)
    np.testing.assert_allclose(moved.translation, start.translation + unit * step[3:])
    np.testing.assert_allclose(moved.rotation, Rotation.from_rotvec(step[:3]).as_matrix() @ start.rotation, atol=1e-14)
    np.testing.assert_allclose(start.local(moved, unit), step, atol=1e-14)
    assert_same(Pose.from_vector(step) @ start, poses_of(step) @ start, 1e-14)


@given(DIRECTIONS, st.floats(0.3, 3.0))
def test_steps_of_a_baseline_are_found_again(direction: Floats, length: float) -> None:
    start = Pose(rotation_about(np.array([0.3, -0.2, 0.5])), length * direction)
    step = 1e-5 * np.array([1.0, -2.0, 0.5, 0.7, -0.3, 1.5])
    np.testing.assert_allclose(start.local_baseline(start.retract_baseline(step)), step, atol=1e-9)
    assert abs(start.retract_baseline(step[:5]).distance - length) < 1e-12
    moved = start.retract_baseline(np.concatenate([np.zeros(3), step[3:]])).translation
    expected = start.by_direction @ step[3:5] + step[5] * start.translation
    np.testing.assert_allclose(moved - start.translation, expected, atol=1e-9)


@given(BATCHES, st.floats(1e-3, 1.0), st.floats(1e-3, 1.0))
def test_near_poses_are_turned_and_moved_by_little(vectors: Floats, turn: float, apart: float) -> None:
    poses, reference = poses_of(vectors), poses_of(vectors[-1])
    angles = Rotation.from_matrix(poses.rotation @ reference.rotation.T).magnitude()
    np.testing.assert_allclose(poses.angle_from(reference), angles, atol=5e-8)
    shifts = np.linalg.norm(vectors[:, 3:] - vectors[-1, 3:], axis=1)
    assume(np.abs(angles - turn).min() > 1e-7 and np.abs(shifts - apart).min() > 1e-12)
    np.testing.assert_array_equal(poses.is_near(reference, turn, apart), (angles < turn) & (shifts < apart))


@given(BATCHES, st.floats(0.1, 10.0))
def test_another_unit_scales_what_a_pose_does(vectors: Floats, factor: float) -> None:
    poses = poses_of(vectors)
    points = vectors[:, None, :3]
    np.testing.assert_allclose(poses.scaled(factor) @ (factor * points), factor * (poses @ points), atol=1e-12)


@given(VECTORS, st.sampled_from([1.0, 1e-6, 1e-9, 0.0]))
def test_rotations_match_scipy(vector: Floats, scale: float) -> None:
    expected = Rotation.from_rotvec(scale * vector)
    np.testing.assert_allclose(rotation_about(scale * vector), expected.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rotation_vector(expected.as_matrix()), expected.as_rotvec(), atol=1e-14)


@given(VECTORS, VECTORS)
def test_the_cross_matrix_multiplies_like_the_cross_product(first: Floats, second: Floats) -> None:
    np.testing.assert_allclose(cross_matrix(first) @ second, np.cross(first, second), atol=1e-14)


@given(BATCHES)
def test_the_nearest_rotation_turns_vectors_as_well_as_can_be(vectors: Floats) -> None:
    """The trace of its transpose with the matrix is the largest; no other rotation's is larger (Kabsch)."""
    matrix = vectors[:3, :3] + np.diag([3.0, 2.0, 1.0])
    nearest = nearest_rotation(matrix)
    np.testing.assert_allclose(nearest @ nearest.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(nearest) > 0
    turned = rotation_about(0.1 * vectors[3, :3]) @ nearest
    assert np.trace(turned.T @ matrix) <= np.trace(nearest.T @ matrix) + 1e-12


@given(DIRECTIONS)
def test_a_direction_and_its_tangents_are_a_frame(direction: Floats) -> None:
    frame = np.column_stack([tangent_basis(direction), direction])
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-14)
