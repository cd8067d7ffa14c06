import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.numerics import Floats
from hw.simulated.scene import Label, Scene
from hw.simulated.shapes import Ball, Block

UNIT_BLOCK = Block(np.zeros(3), np.eye(3))
TILTED_BLOCK = Block(np.array([1.0, 2.0, -0.3]), np.array([[2.0, 0.3, 0.0], [-0.2, 1.5, 0.1], [0.0, 0.2, 0.9]]))
ROOM = Block(np.zeros(3), np.diag([4.0, 5.0, 2.5]))
BOX = Block(np.array([1.0, 1.0, 0.0]), np.diag([0.5, 0.4, 0.3]))
BALL = Ball(np.array([0.6, 0.5, 0.2]), 0.2)
SCENE = Scene(ROOM, (BOX,), BALL)


def column(*numbers: float) -> Floats:
    return np.array(numbers, np.float64)[:, None]


@pytest.mark.parametrize(
    ("origin", "direction", "t", "face"),
    [
        ((-1, 0.5, 0.5), (1, 0, 0), 1.0, 0),
        ((3, 0.5, 0.5), (-0.5, 0, 0), 4.0, 3),
        ((0.5, -2, 0.5), (0, 1, 0), 2.0, 1),
        ((0.5, 0.5, 4), (0, 0, -1), 3.0, 5),
        ((-1, 0.5, 0.5), (-1, 0, 0), np.inf, 0),
        ((-1, 2.0, 0.5), (1, 0, 0), np.inf, 0),
    ],
)
def test_rays_enter_a_block(origin: tuple[float, ...], direction: tuple[float, ...], t: float, face: int) -> None:
    found_t, found_face = UNIT_BLOCK.enter(column(*origin), column(*direction))
    assert found_t[0] == pytest.approx(t)
    assert found_face[0] == face


@given(st.integers(0, 10_000))
def test_rays_enter_a_block_through_the_returned_face(seed: int) -> None:
    rng = np.random.default_rng(seed)
    origins = rng.normal(0, 5, (3, 50)) + column(40, 0, 0)
    inside = TILTED_BLOCK.origin[:, None] + TILTED_BLOCK.edges.T @ rng.uniform(0.01, 0.99, (3, 50))
    directions = (inside - origins) * rng.uniform(0.2, 3, 50)
    t, face = TILTED_BLOCK.enter(origins, directions)
    coordinates = TILTED_BLOCK.coordinates(origins + t * directions)
    np.testing.assert_allclose(coordinates[face % 3, np.arange(50)], face // 3, atol=1e-9)
    assert np.all((coordinates > -1e-9) & (coordinates < 1 + 1e-9))
    # Looking at a face from outside means against its normal.
    assert np.all(np.sum(TILTED_BLOCK.outward_normals[face].T * directions, axis=0) < 0)


def test_rays_enter_a_sphere_at_its_near_side() -> None:
    ball = Ball(np.array([0.0, 0.0, 5.0]), 2.0)
    directions = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.41, 1.0]]).T
    np.testing.assert_allclose(ball.enter(np.zeros((3, 1)), directions)[:2], [3.0, np.inf])
    # tan of the half angle at which a ball of radius 2 in a distance of 5 is seen: 2 / √21 = 0.436
    assert 3.0 < ball.enter(np.zeros((3, 1)), directions)[2] < 5.0
    assert ball.enter(np.zeros((3, 1)), column(0.0, 0.44, 1.0))[0] == np.inf


@given(st.integers(0, 10_000))
def test_the_nearest_surface_is_hit_and_its_coordinates_give_the_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    origin = column(3.0, 3.5, 1.5)
    targets = rng.uniform(0, 1.5, (3, 200))
    t, surface = SCENE.cast(origin, targets - origin)
    points = origin + t * (targets - origin)
    assert not SCENE.occluded(points, origin[:, 0]).any()
    uv = SCENE.surface_coordinates(surface, points)
    assert np.all(uv > -1e-9)
    assert np.all(uv < SCENE.sizes[surface].T + 1e-9)
    for number in np.unique(surface):
        on = surface == number
        np.testing.assert_allclose(SCENE.points_on(int(number), uv[:, on]), points[:, on], atol=1e-9)
    # A little way along the normal is air, a little way against it is not.
    normals = SCENE.normals(surface, points)
    assert SCENE.is_free(points + 1e-6 * normals).all()
    assert not SCENE.is_free(points - 1e-6 * normals).any()


@pytest.mark.parametrize(
    ("target", "label"),
    [
        ((0.0, 2.5, 2.0), Label.WALL_X),
        ((2.5, 0.0, 2.0), Label.WALL_Y),
        ((2.5, 2.5, 0.0), Label.FLOOR),
        ((4.0, 1.0, 2.0), Label.SURROUNDINGS),
        ((1.2, 1.2, 0.1), Label.FURNITURE),
        ((0.6, 0.5, 0.39), Label.SPHERE),
    ],
)
def test_labels(target: tuple[float, ...], label: Label) -> None:
    origin = column(2.0, 1.9, 2.0)
    _, surface = SCENE.cast(origin, column(*target) - origin)
    assert SCENE.labels[surface[0]] == label


def test_furniture_hides_what_is_behind_it() -> None:
    eye = np.array([3.0, 2.5, 1.0])
    behind_box, beside_box, behind_ball = column(0.75, 0.9, 0.0), column(2.0, 0.5, 0.0), column(0.3, 0.2, 0.05)
    assert SCENE.occluded(np.hstack([behind_box, beside_box, behind_ball]), eye).tolist() == [True, False, True]
