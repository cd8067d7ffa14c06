"""Planes: heights, motions, steps and the plane through points."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calib.geometry.plane import Plane
from calib.geometry.pose import Pose
from calib.numerics import Floats

LENGTHS = st.floats(-3.0, 3.0)
VECTORS = arrays.arrays(np.float64, 6, elements=LENGTHS)
POINTS = arrays.arrays(np.float64, (7, 3), elements=LENGTHS)


@st.composite
def planes(draw: st.DrawFn) -> Plane:
    normal = draw(arrays.arrays(np.float64, 3, elements=LENGTHS).filter(lambda vector: np.linalg.norm(vector) > 0.1))
    return Plane(normal / np.linalg.norm(normal), draw(LENGTHS))


@given(planes(), VECTORS, st.floats(0.1, 10.0), POINTS)
def test_heights_move_with_the_plane(plane: Plane, vector: Floats, factor: float, points: Floats) -> None:
    motion = Pose.from_vector(vector)
    heights = plane.moved(motion, factor).heights(factor * (motion @ points))
    np.testing.assert_allclose(heights, factor * plane.heights(points), atol=1e-11)


@given(planes(), arrays.arrays(np.float64, 3, elements=LENGTHS))
def test_a_step_is_found_again(plane: Plane, step: Floats) -> None:
    np.testing.assert_allclose(plane.local(plane.retract(step)), step, atol=1e-11)


@given(planes(), arrays.arrays(np.float64, 3, elements=LENGTHS), POINTS)
def test_rays_end_on_the_plane(plane: Plane, origin: Floats, directions: Floats) -> None:
    directions = directions[np.abs(directions @ plane.normal) > 1e-3]
    ends = origin + plane.depths(directions, origin)[:, None] * directions
    np.testing.assert_allclose(plane.heights(ends), 0.0, atol=1e-8)
    assert abs(plane.offset_from(origin) + plane.heights(origin)) < 1e-12


@given(planes(), st.integers(0, 1000), LENGTHS.filter(lambda height: abs(height) > 0.1))
def test_the_plane_through_its_points_faces_where_it_is_seen_from(plane: Plane, seed: int, height: float) -> None:
    points = np.random.default_rng(seed).normal(size=(20, 3))
    points -= plane.heights(points)[:, None] * plane.normal
    fitted = Plane.through(points, np.ones(20), points.mean(axis=0) + height * plane.normal)
    sign = np.sign(height)
    np.testing.assert_allclose(fitted.normal, sign * plane.normal, atol=1e-9)
    assert abs(fitted.offset - sign * plane.offset) < 1e-9
