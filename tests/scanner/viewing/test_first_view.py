"""The first view: labels apart, near walls seen through, a scale bar that is right, and pictures that are kept.

Labels are beside what they name.
"""

import re
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageSequence
from scipy.spatial.transform import Rotation

from calib.numerics import Floats
from scanner.viewing.colouring import Colouring, coloured
from scanner.viewing.geometry import (
    FIELD_OF_VIEW_RAD,
    ScaleBar,
    TextLabel,
    Viewpoint,
    WindowView,
    area_of,
    arranged,
    scale_bar,
    scale_bar_html,
    turned,
    viewpoint,
)
from scanner.viewing.keeping import Margin, completed, gif, png
from scanner.viewing.result import CaptureCloud, ViewedCloud
from scanner.viewing.scene import _end_of_common_edge
from scanner.viewing.windows import PartKind, room_parts

UP = np.array([0.0, 0.0, 1.0])


def window(width: int = 1010, height: int = 900) -> WindowView:
    view = Viewpoint(np.array([0.0, -4.0, 2.0]), np.zeros(3), UP)
    return WindowView.towards(view, FIELD_OF_VIEW_RAD, width, height)


@given(st.lists(st.tuples(st.text(min_size=1, max_size=30), *[st.floats(-2, 2)] * 3), max_size=30))
def test_no_label_lies_over_another_or_is_cut_off(drawn: list[tuple[str, float, float, float]]) -> None:
    labels = [TextLabel(text, np.array(place), "center-center") for text, *place in drawn]
    for view in (window(), window(2020, 1800)):  # the second on a screen with twice the pixels
        assert view.density == view.height // 900
        assert_apart(labels, view)


def assert_apart(labels: list[TextLabel], view: WindowView) -> None:
    anchors = arranged(labels, view)
    assert len(anchors) == len(labels)
    areas = []
    for label, anchor in zip(labels, anchors, strict=True):
        (pixel,), (depth,) = view.project(label.place[None])
        if depth > 0 and np.all((pixel >= 0) & (pixel <= (view.width, view.height))) and anchor is not None:
            areas.append(area_of(label.text, pixel, anchor, view.density))
    for number, area in enumerate(areas):
        assert np.all(area >= 0)
        assert area[2] <= view.width
        assert area[3] <= view.height
        for other in areas[:number]:
            assert not (np.all(area[:2] < other[2:]) and np.all(other[:2] < area[2:]))


def test_a_label_with_room_stays_as_it_wants_to_be() -> None:
    apart = [
        TextLabel("one", np.array([-1.0, 0.0, 0.0]), "top-left"),
        TextLabel("two", np.array([1.0, 0.0, 0.0]), "top-left"),
    ]
    assert arranged(apart, window()) == ("top-left", "top-left")
    first, second = arranged([apart[0], replace(apart[1], place=apart[0].place)], window())
    assert (first, second is None) == ("top-left", False)
    assert second != first


def of_room(size: Floats, per_side: int = 40) -> ViewedCloud:
    """A box of points from inside, x, y, z from 0 to `size` (3,), normals inwards."""
    grid = np.stack(np.meshgrid(*[np.linspace(0.02, 0.98, per_side)] * 2), axis=-1).reshape(-1, 2)
    points, normals = [], []
    for axis in range(3):
        for end in (0.0, 1.0):
            side = np.insert(grid, axis, end, axis=1) * size
            points.append(side)
            normals.append(np.tile(np.eye(3)[axis] * (1 - 2 * end), (len(side), 1)))
    stacked = np.concatenate(points)
    colours = np.full((len(stacked), 3), 200, np.uint8)
    return ViewedCloud(stacked, np.concatenate(normals), colours, (), None, UP, "m", "room")


def test_walls_and_ceiling_are_those_that_one_looks_at_from_behind() -> None:
    size = np.array([4.0, 3.0, 2.5])
    cloud = of_room(size)
    parts = room_parts(cloud)
    assert sorted(part.kind for part in parts) == ["Ceiling", *["Walls"] * 4]
    for part in parts:
        assert len(part.points) == 1600
        assert np.ptp(cloud.points[part.points] @ part.normal) < 1e-9
        assert not part.is_before(size / 2)
    outside = np.array([2.0, -5.0, 6.0])
    before = [part for part in parts if part.is_before(outside)]
    assert {part.kind for part in before} == {PartKind.WALL, PartKind.CEILING}
    assert sorted(float(part.normal @ (0, 1, 0)) for part in before) == pytest.approx([0.0, 1.0])


@pytest.mark.parametrize("turn_deg", [0.0, 14.0, 45.0, 83.0])
def test_a_turned_room_has_the_same_walls(turn_deg: float) -> None:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    cloud = of_room(np.array([4.0, 3.0, 2.5]))
    turned_room = replace(cloud, points=cloud.points @ turn.T, normals=cloud.normals @ turn.T)
    assert [len(part.points) for part in room_parts(turned_room)] == [1600] * 5


def test_things_and_the_fronts_of_cupboards_are_no_walls() -> None:
    cloud = of_room(np.array([4.0, 3.0, 2.5]))
    assert room_parts(replace(cloud, normals=-cloud.normals)) == ()  # sides that face outwards
    assert room_parts(replace(cloud, has_walls=False)) == ()
    assert room_parts(replace(cloud, normals=0 * cloud.normals)) == ()  # of live clouds
    parts = room_parts(cloud)
    on_wall = parts[0].points[:800]
    points = cloud.points.copy()
    points[on_wall] += 0.6 * parts[0].normal  # half of the wall is the front of a cupboard
    assert len(room_parts(replace(cloud, points=points))[0].points) == 800


@pytest.mark.parametrize("aspect", [0.46, 1.0, 1.8])
@pytest.mark.parametrize("upper_share", [1.0, 0.55])
def test_the_cloud_is_in_the_middle_of_what_nothing_covers(
    cloud: CaptureCloud, aspect: float, upper_share: float
) -> None:
    view = WindowView.towards(viewpoint(cloud, aspect, upper_share), FIELD_OF_VIEW_RAD, round(900 * aspect), 900)
    (rig,) = cloud.rigs
    pixels, depth = view.project(np.stack([rig.position, rig.projector_centre, *cloud.points[::997]]))
    assert np.all(depth > 0)
    assert np.all((pixels >= 0) & (pixels <= (view.width, 900 * upper_share)))
    middle = view.project(cloud.points[::997])[0]
    off = (middle.min(axis=0) + middle.max(axis=0)) / 2 - (view.width / 2, 450 * upper_share)
    assert np.all(np.abs(off) < 0.02 * 900)


@given(st.floats(1e-3, 1e5))
def test_the_scale_bar_is_as_long_as_it_says(px_per_m: float) -> None:
    bar = scale_bar(px_per_m, "m")
    assert 55 < bar.width_px < 145
    length_mm, unit = bar.text.split()
    assert unit == "mm"
    assert bar.width_px == pytest.approx(float(length_mm) / 1000 * px_per_m, rel=1e-5)
    html = scale_bar_html(bar, 900)
    assert bar.text in html
    share = re.search(r"width: ([\d.]+)vh", html)  # of the page's height, whatever its pixels are
    assert share is not None
    assert float(share[1]) / 100 * 900 == pytest.approx(bar.width_px, abs=0.01)


def test_a_turn_goes_round_about_the_upright_axis() -> None:
    view = Viewpoint(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 0.5]), UP)
    quarter = turned(view, np.pi / 2)
    assert quarter.position == pytest.approx([1.0, 3.0, 2.0])
    assert turned(view, 2 * np.pi).position == pytest.approx(view.position)


def test_kept_pictures_state_scale_and_colours(cloud: CaptureCloud) -> None:
    bar = coloured(cloud, cloud.order[:1000], Colouring.DEPTH).bar
    drawn = np.zeros((300, 400, 4), np.uint8)  # nothing was drawn: the background is white
    drawn[100:150, 150:250] = (200, 30, 30, 255)
    scale = ScaleBar(60.0, "500 mm")
    plain, explained = (
        np.asarray(completed(drawn, margin, 1.0)) for margin in (Margin(scale), Margin(scale, "Depth", bar))
    )
    assert plain.shape == (300, 400, 3)
    assert np.all(plain[110, 200] == (200, 30, 30))
    assert np.all(plain[:90] == 255)
    assert 58 <= np.all(plain < 60, axis=2).sum(axis=1).max() <= 64  # the bar's longest row
    legend = np.any(explained != plain, axis=2)
    assert 2000 < legend.sum() < 10_000
    twice = Image.open(BytesIO(png(completed(drawn, Margin(scale), 2.0))))
    assert twice.size == (400, 300)
    turn = Image.open(BytesIO(gif(completed(np.roll(drawn, step, axis=1), Margin(scale), 1.0) for step in (0, 40, 80))))
    assert (turn.format, sum(1 for _ in ImageSequence.Iterator(turn)), turn.info["loop"]) == ("GIF", 3, 0)


@pytest.mark.parametrize("seed", range(5))
def test_an_angles_label_is_two_thirds_along_the_common_edge_of_its_faces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertex, legs = rng.normal(size=3), Rotation.random(random_state=seed).as_matrix() * rng.uniform(1, 3, (3, 1))
    first = vertex + np.array([np.zeros(3), legs[0], legs[0] + legs[1], legs[1]])
    second = vertex + np.array([np.zeros(3), legs[0], legs[0] + legs[2], legs[2]])
    np.testing.assert_allclose(_end_of_common_edge(first, second), vertex + 2 / 3 * legs[0], atol=1e-12)
