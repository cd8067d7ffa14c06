import numpy as np
import pytest
from numpy.typing import NDArray

from calib.pointcloud import Cloud, CloudStatistics, build_cloud
from calib.synthetic import PAPER_CAMERA
from scanner.rendering.cloud_views import Wireframe, frustum, render, standard_views, view_along
from tests.support.cloud_scene import Scene, room

FORWARD, UP = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
STATISTICS = CloudStatistics(0, 0, 0, 0, 0, 0, 0, 1.0, 0.0, 0.0)


def square(depth: float, side: int, colour: tuple[int, int, int], facing: float = -1.0) -> list[NDArray[np.float64]]:
    """Points 1 unit apart on a square at a depth, with normals along z."""
    x, y = np.meshgrid(np.arange(side) - side / 2, np.arange(side) - side / 2)
    points = np.stack([x, y, np.full_like(x, depth)], axis=-1)
    return [points, np.broadcast_to(colour, points.shape), np.broadcast_to((0.0, 0.0, facing), points.shape)]


def cloud_of(*parts: list[NDArray[np.float64]]) -> Cloud:
    points, colours, normals = (np.concatenate([part[i].reshape(1, -1, 3) for part in parts], axis=1) for i in range(3))
    nothing = np.full(points.shape[:2], np.nan, dtype=np.float32)
    match = np.zeros(points.shape[:2], dtype=np.int32)
    arrays = points.astype(np.float32), colours.astype(np.uint8), normals.astype(np.float32), nothing, match
    return Cloud(*arrays, "m", STATISTICS)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return room()


def test_views_are_right_handed_and_upright() -> None:
    for view in standard_views(np.array([0.1, 0.3, 1.0]), np.array([0.05, -1.0, 0.1])).values():
        assert np.allclose(view.axes @ view.axes.T, np.eye(3))
        assert np.linalg.det(view.axes) == pytest.approx(1)
    assert view_along(FORWARD, UP).axes == pytest.approx(np.eye(3))


def test_a_square_fills_its_picture_without_gaps() -> None:
    picture = render(cloud_of(square(5, 120, (200, 100, 50))), view_along(FORWARD, UP), (200, 200), [])
    inner = picture[20:-20, 20:-20]
    assert (inner[..., 3] == 255).all()
    assert not picture[:5, :5, 3].any()
    red, green, blue = inner.reshape(-1, 4)[:, :3].mean(axis=0)
    assert red > 1.5 * green > 2 * blue


@pytest.mark.parametrize("place", [(0.0, 0.0, 5.0), (0.0, 0.0, 0.0), (-3e6, 2.0, 1.0)])
def test_what_has_no_extent_has_a_picture(place: tuple[float, float, float]) -> None:
    """A single point faces some side of a thing of which little was seen."""
    point = [np.array([[place]]), np.array([[[200, 100, 50]]]), np.array([[[0.0, 0.0, -1.0]]])]
    picture = render(cloud_of(point), view_along(FORWARD, UP), (200, 200), [])
    assert 0 < np.count_nonzero(picture[..., 3]) < 200
    assert 0 < len(picture) <= 201


def test_the_nearer_surface_hides_the_farther() -> None:
    near, far = square(3, 60, (255, 0, 0)), square(6, 120, (0, 0, 255))
    for parts in ((near, far), (far, near)):
        picture = render(cloud_of(*parts), view_along(FORWARD, UP), (200, 200), [])
        middle, side = picture[100, 100], picture[100, 25]
        assert middle[0] > 100
        assert middle[2] == 0
        assert side[2] > 100
        assert side[0] == 0


def test_surfaces_facing_away_are_not_drawn() -> None:
    wall_from_behind, inside = square(3, 120, (255, 0, 0), facing=1.0), square(6, 120, (0, 0, 255))
    picture = render(cloud_of(wall_from_behind, inside), view_along(FORWARD, UP), (200, 200), [])
    assert picture[..., 0].max() == 0
    assert picture[100, 100, 2] > 100


def test_wireframes_are_drawn_and_enlarge_the_picture() -> None:
    line = Wireframe(np.array([[[0.0, 0.0, 5.0], [60.0, 0.0, 5.0]]]), (0, 200, 0))
    picture = render(cloud_of(square(5, 40, (255, 0, 0))), view_along(FORWARD, UP), (400, 400), [line])
    assert picture.shape[1] > 1.5 * picture.shape[0]
    assert picture[..., 1].max() == 200


def test_an_empty_cloud_gives_an_empty_picture() -> None:
    picture = render(cloud_of(square(5, 0, (0, 0, 0))), view_along(FORWARD, UP), (100, 80), [])
    assert picture.shape[2] == 4
    assert not picture[..., 3].any()


def test_the_plan_of_a_corner_shows_its_walls_as_lines_at_a_right_angle(scene: Scene) -> None:
    cloud = build_cloud(scene.matches, scene.texture, scene.calibration)
    walls = cloud.normals @ scene.corner.legs[2]
    upright = cloud.there & (np.abs(walls) < 0.2)
    points = cloud.points[upright] @ standard_views(FORWARD, scene.corner.legs[2])["top"].axes.T
    on_wall = [np.abs(cloud.normals[upright] @ scene.corner.normals[i]) > 0.99 for i in (0, 1)]
    directions = [np.linalg.eigh(np.cov(points[chosen][:, :2].T))[1][:, 1] for chosen in on_wall]
    assert abs(directions[0] @ directions[1]) < 0.01


def test_a_frustum_spans_the_field_of_view() -> None:
    edges = frustum(PAPER_CAMERA, 2.0)
    assert edges.shape == (8, 2, 3)
    assert np.linalg.norm(edges[:4, 1], axis=1) == pytest.approx(2.0)
    back = PAPER_CAMERA.project(edges[:4, 1])
    assert back == pytest.approx(np.array([[0, 0], [2447, 0], [2447, 2047], [0, 2047]]), abs=1e-6)
