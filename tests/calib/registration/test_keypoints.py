"""Pictures resolve what surfaces leave open: a bare room with equal corners."""

from dataclasses import replace

import numpy as np
import pytest

from calib.registration import StationView, find_keypoints, register
from calib.registration.hypotheses import keypoint_poses
from calib.registration.keypoints import Keypoints, match_keypoints
from calib.registration.range_view import surfaces_of
from calib.synthetic import Paint, StationCloud, random_furnished_room, ring, seen_from
from tests.calib.registration.test_register import CAMERA, off, view_of


def with_keypoints(station: StationCloud) -> StationView:
    view = view_of(station)
    return replace(view, keypoints=find_keypoints(station.picture, view.points, view.labels, view.planes, view.camera))


@pytest.fixture(scope="module")
def painted() -> list[StationCloud]:
    """Three neighbours of a bare room that is ambiguous without its pictures (test_registration)."""
    rng = np.random.default_rng(3)
    room = random_furnished_room(rng, 0)
    places = ring(rng, room, 6)[:3]
    return [seen_from(room, place, rng, camera=CAMERA, paint=Paint(3, 0.3)) for place in places]


@pytest.fixture(scope="module")
def views(painted: list[StationCloud]) -> list[StationView]:
    return [with_keypoints(station) for station in painted]


def test_matching_marks_are_paired(painted: list[StationCloud], views: list[StationView]) -> None:
    pose = painted[0].place.inverse() @ painted[1].place
    first, second = views[0].keypoints, views[1].keypoints
    own, other = match_keypoints(first, second)
    moved = pose @ second.points[other]
    far, depth = np.linalg.norm(moved - first.points[own], axis=1), first.points[own, 2]
    assert len(far) >= 12
    right = far < 0.02 * depth
    assert 0.6 < right.mean() <= 1.0
    # The calibration that bends the cloud by 0.3 % moves them, too.
    assert 0.0005 < np.median(far[right]) < 0.03


def test_marks_alone_determine_the_pose(painted: list[StationCloud], views: list[StationView]) -> None:
    poses = keypoint_poses(*(surfaces_of(view) for view in views[:2]))
    degrees, metres = off(poses[0], painted[0].place.inverse() @ painted[1].place)
    assert 1e-3 < degrees < 0.8
    assert 1e-4 < metres < 0.04


def test_pictures_resolve_a_bare_room(painted: list[StationCloud], views: list[StationView]) -> None:
    (group,) = register([views[2], views[0], views[1]]).groups
    assert group.stations == (0, 1, 2)
    assert not group.ambiguous
    for number, k in ((1, 0), (2, 1)):
        degrees, metres = off(group.places[number], painted[2].place.inverse() @ painted[k].place)
        assert 1e-4 < degrees < 0.6
        assert 1e-4 < metres < 0.05


def test_repeated_marks_are_not_used(views: list[StationView]) -> None:
    keypoints = views[0].keypoints
    twice = Keypoints(
        np.tile(keypoints.pixels, (2, 1)),
        np.tile(keypoints.points, (2, 1)),
        np.tile(keypoints.labels, 2),
        np.tile(keypoints.descriptors, (2, 1)),
    )
    assert len(match_keypoints(keypoints, keypoints)[0]) > 0.8 * len(keypoints)
    assert len(match_keypoints(keypoints, twice)[0]) == 0


def test_a_picture_of_another_size_is_an_error(painted: list[StationCloud], views: list[StationView]) -> None:
    view = views[0]
    with pytest.raises(ValueError, match=r"\(256, 306\)"):
        find_keypoints(painted[0].picture[1:], view.points, view.labels, view.planes, view.camera)
