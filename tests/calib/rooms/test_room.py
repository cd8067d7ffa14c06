import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.numerics import Floats
from calib.refinement import SHARED
from calib.rooms import Room
from tests.calib.rooms.conftest import Case
from tests.support.states import gradient_of

SMALL = 1e-3


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_step_to_undoes_moved(case: Case, seed: int) -> None:
    room = case.truth
    step = np.random.default_rng(seed).normal(0, SMALL, room.size)
    there = room.moved(step)
    assert np.allclose(room.step_to(there), step, atol=20 * SMALL**2)
    assert np.allclose(room.step_to(room), 0.0)


def test_planes_and_poses_stay_normalised(case: Case) -> None:
    moved = case.truth.moved(np.full(case.truth.size, 0.1))
    for plane in moved.planes:
        assert abs(np.linalg.norm(plane.normal) - 1) < 1e-12
    for place in moved.places:
        assert np.allclose(place.rotate(place.rotation), np.eye(3))
        assert np.linalg.det(place.rotation) > 0


def test_columns_do_not_overlap(case: Case) -> None:
    room, every = case.truth, np.arange(case.truth.size)
    parts = [every[:SHARED], *(every[room.place_columns(i)] for i in range(len(room.places)))]
    parts += [every[room.plane_columns(i)] for i in range(len(room.planes))]
    assert np.array_equal(np.concatenate(parts), every)


def test_the_numerical_gradient_of_a_known_function(case: Case) -> None:
    """The numerical gradient that other tests use."""

    def offset(room: Room) -> Floats:
        return np.array(room.planes[0].offset)

    expected = np.zeros(case.truth.size)
    expected[case.truth.plane_columns(0).stop - 1] = 1.0
    assert np.allclose(gradient_of(offset, case.truth), expected, atol=1e-9)
