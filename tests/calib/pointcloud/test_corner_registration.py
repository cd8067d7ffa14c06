"""The order of the corner's legs, found in simulated rooms and compared with their truth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.geometry import Corner, Intrinsics
from calib.pointcloud.corner_registration import CornerView, find_order
from hw.settings import SimulatedRigSettings
from hw.simulated import paint, place_room
from tests.support.whole_room import lit_picture, observed

CAMERA, PROJECTOR = (204, 171), (214, 120)

pytestmark = pytest.mark.xdist_group("alignment")


@cache
def seen(seed: int, pose: int, *, furniture: bool) -> CornerView:
    """The lit part of a room; the corner's legs are the world's axes in order."""
    room = place_room(SimulatedRigSettings(seed=seed, pose=pose, furniture=furniture), CAMERA, PROJECTOR)
    lit, camera = observed(room, np.random.default_rng(pose), 0.0), room.camera
    points = np.full((CAMERA[0] * CAMERA[1], 3), np.nan, np.float32)
    points[lit.pixel] = lit.points
    picture = lit_picture(room, paint(room.scene, np.random.default_rng(seed), None), np.random.default_rng(pose))
    corner = Corner(-camera.rotation @ camera.centre, camera.rotation.T)
    return CornerView(points.reshape(*picture.shape, 3), picture.astype(np.float32), lit.calibration.camera, corner)


def renumbered(view: CornerView, turn: int) -> CornerView:
    """The view with its legs numbered clockwise from another leg, as a joint calibration numbers them."""
    legs = np.roll(view.corner.legs[[0, 2, 1]], turn, axis=0)
    return replace(view, corner=Corner(view.corner.vertex, legs))


def world_axes(view: CornerView, turn: int, original: CornerView) -> list[int]:
    """The world's axes of the axes of the corner's frame."""
    axes = np.roll(view.axes, turn, axis=0)
    return [int(axis) for axis in np.argmax(np.abs(axes @ original.corner.legs.T), axis=1)]


@pytest.mark.parametrize(
    ("seed", "furniture"), [(0, True), (2, True), (0, False)], ids=["furnished", "furnished otherwise", "posters only"]
)
def test_the_order_of_legs_is_found_from_overlap(seed: int, furniture: bool) -> None:
    originals = [seen(seed, pose, furniture=furniture) for pose in (0, 1, 2)]
    views = [renumbered(view, turn) for view, turn in zip(originals, (0, 2, 1), strict=True)]
    order = find_order(views)
    assert order.decided
    assert order.refuted < 0.1
    axes = [world_axes(*each) for each in zip(views, order.turns, originals, strict=True)]
    assert axes[0] == axes[1] == axes[2]
    assert axes[0][2] == 2  # the world's z points up


def test_bare_walls_of_one_colour_are_ambiguous() -> None:
    views = [replace(seen(0, pose, furniture=False), brightness=None) for pose in (0, 1)]
    order = find_order(views)
    assert not order.decided
    assert order.nats > 0  # nobody turns a rig on its side, but that is no proof


@pytest.mark.filterwarnings("error")
def test_a_view_of_nothing_decides_nothing() -> None:
    view = seen(0, 0, furniture=True)
    nothing = replace(view, points=np.full_like(view.points, np.nan))
    for views in ([view, nothing], [nothing, nothing]):
        order = find_order(views)
        assert not order.decided
        assert order.refuted == 0


def test_another_room_is_detected() -> None:
    order = find_order([seen(0, 0, furniture=True), seen(2, 0, furniture=True)])
    assert not order.decided
    assert order.refuted > 0.5


def test_many_views_take_no_longer_than_few() -> None:
    originals = [seen(0, pose, furniture=True) for pose in (0, 1)] * 8
    turns = [int(turn) for turn in np.random.default_rng(1).integers(0, 3, len(originals))]
    views = [renumbered(*each) for each in zip(originals, turns, strict=True)]
    order = find_order(views)
    assert order.decided
    axes = [world_axes(*each) for each in zip(views, order.turns, originals, strict=True)]
    assert axes == [axes[0]] * len(views)


def test_a_transform_and_its_inverse() -> None:
    view = renumbered(seen(0, 1, furniture=True), 1)
    points = np.random.default_rng(0).normal((0, 0, 3), 1, (20, 3))
    for turn in range(3):
        there = view.in_corner(points, turn)
        np.testing.assert_allclose(view.in_camera(there, turn), points, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(there, axis=1), np.linalg.norm(points - view.corner.vertex, axis=1))
    assert np.linalg.det(view.axes) == pytest.approx(1.0)


def test_legs_off_square_give_the_nearest_rotation() -> None:
    legs = np.eye(3) + np.radians(0.3) * np.array([[0, 1, -1], [0.5, 0, 1], [1, -0.5, 0]])
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    camera = Intrinsics(4, 3, (3.0, 3.0), (1.5, 1.0))
    view = CornerView(np.full((3, 4, 3), np.nan, np.float32), None, camera, Corner(np.zeros(3), legs))
    np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
    apart = np.degrees(np.arccos(np.clip(np.sum(view.axes * legs, axis=1), -1, 1)))
    assert np.all((apart > 0) & (apart < 0.6))
