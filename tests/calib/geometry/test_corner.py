"""The legs, normals, axes and planes of a corner."""

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.geometry.corner import Corner, depths_on_planes, polar

SEEDS = st.integers(0, 10_000)


def test_legs_and_normals_are_polar_to_each_other() -> None:
    legs = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix() + np.radians([[0, 2, 0], [0, 0, -3], [4, 0, 0]])
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    normals = polar(legs)
    assert np.all(np.sum(normals * legs, axis=1) > 0.9)
    assert normals @ legs.T - np.diag(np.diag(normals @ legs.T)) == pytest.approx(np.zeros((3, 3)), abs=1e-15)
    assert polar(normals) == pytest.approx(legs, abs=1e-15)


def test_axes_are_the_nearest_rotation_to_the_legs_with_up_vertical() -> None:
    rotation = Rotation.from_rotvec([0.1, 0.2, -0.1]).as_matrix()
    corner = Corner(np.array([0.0, 0.0, 3.0]), rotation[[0, 2, 1]])  # numbered the left-handed way round
    assert corner.axes == pytest.approx(rotation, abs=1e-12)
    assert corner.up == pytest.approx(-rotation[1], abs=1e-12)  # y points down in the camera's frame


def test_rays_meet_their_planes() -> None:
    rng = np.random.default_rng(0)
    rays = np.column_stack([rng.uniform(-0.5, 0.5, (5, 2)), np.ones(5)])
    normals, vertex = rng.normal(size=(5, 3)), np.array([0.2, -0.1, 2.0])
    points = depths_on_planes(rays, normals, vertex)[:, None] * rays
    assert np.sum(normals * (points - vertex), axis=1) == pytest.approx(np.zeros(5), abs=1e-12)
