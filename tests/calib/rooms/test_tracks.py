"""Points of a plane tracked between two pictures, compared with the truth."""

from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import PER_POSE, Plane, Pose
from calib.numerics import Floats
from calib.refinement import SHARED, State, device_of
from calib.rooms import LabelledPicture, Room
from calib.rooms.factors import Track
from calib.rooms.point_tracking import find_tracks
from calib.synthetic import CloudErrors, Paint, random_furnished_room, ring, seen_from
from tests.calib.registration.test_register import CAMERA
from tests.support.states import gradient_of

Scene = tuple[Room, list[LabelledPicture], list[tuple[int, ...]]]


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Two stations of a bare painted room, its walls and floor, in metres."""
    rng = np.random.default_rng(3)
    made = random_furnished_room(rng, 0)
    places = ring(rng, made, 6)[:2]
    seen = [seen_from(made, place, rng, CloudErrors(0.0, 0.0), CAMERA, Paint(3, 0.3)) for place in places]
    device, along = device_of(CAMERA), np.array([1.0, 0.0, 0.0])
    rig = State(device, device, Pose(np.eye(3), along))
    normals, heights = made.scene.solids[0]
    planes = tuple(Plane(normal, float(height)) for normal, height in zip(normals, heights, strict=True))
    sights = []
    for station in seen:
        points = station.place @ station.points
        away = np.abs(points @ normals.T - heights)
        on = np.nanmin(np.where(np.isfinite(away), away, 9.0), axis=2) < 1e-3
        labels = np.where(on, np.argmin(np.where(np.isfinite(away), away, 9.0), axis=2), -1)
        sights.append(LabelledPicture.of(station.picture, labels.astype(np.int32)))
    room = Room(rig.rig, tuple(places), planes)
    return room, sights, [tuple(range(6))] * 2


@pytest.fixture(scope="module")
def tracks(scene: Scene) -> tuple[Track, ...]:
    room, sights, plane_of = scene
    return find_tracks(sights, plane_of, room)


def shifted(room: Room, shift: Floats) -> Room:
    place = room.places[1]
    return replace(room, places=(room.places[0], Pose(place.rotation, place.translation + shift)))


def test_tracked_points_coincide(scene: Scene, tracks: tuple[Track, ...]) -> None:
    assert sum(len(track.variance) for track in tracks) > 60
    for track in tracks:
        off, _, _ = track.differences(scene[0])
        assert 1e-5 < np.median(np.linalg.norm(off, axis=1)) < 0.008  # a pixel is 13 mm wide at 3 m
        assert 0.3 < np.sqrt(np.mean(off**2 / track.variance[:, None])) < 2.0


def test_derivatives_of_differences_match_finite_differences(scene: Scene, tracks: tuple[Track, ...]) -> None:
    room, track = scene[0], tracks[0]
    columns = track.columns(room).tolist()
    # Where there is a difference it turns with the plane's axes: derivatives are those of points that coincide.
    _, by_room, _ = track.differences(room)
    numeric = gradient_of(lambda moved: track.differences(moved)[0], room, columns)
    assert np.allclose(by_room, numeric, atol=2e-3 * np.abs(numeric).max())


def test_tracks_correct_a_station_shifted_along_a_wall(scene: Scene) -> None:
    room, sights, plane_of = scene
    shift = np.array([0.03, -0.02, 0.0])
    moved = shifted(room, shift)
    for _ in range(3):
        found = find_tracks(sights, plane_of, moved)
        own = slice(SHARED + PER_POSE + 3, SHARED + 2 * PER_POSE)  # where the second of a pair is
        sums = [track.misfit(moved) for track in found]
        hessian = np.sum([each.information[own, own] for each in sums], axis=0)
        moved = shifted(moved, -np.linalg.solve(hessian, np.sum([each.gradient[own] for each in sums], axis=0)))
    left = np.linalg.norm(moved.places[1].translation - room.places[1].translation)
    assert 1e-6 < left < 0.002


def test_different_lighting_shifts_no_track(scene: Scene) -> None:
    room, sights, plane_of = scene
    height, width = sights[1].light.shape
    slope = np.linspace(-40, 40, width)[None, :] + np.linspace(30, -30, height)[:, None]
    lit = np.clip(sights[1].light + slope, 0, 255).astype(np.uint8)
    found = find_tracks([sights[0], replace(sights[1], light=lit)], plane_of, room)
    off = np.concatenate([track.differences(room)[0] for track in found])
    assert len(off) > 40
    assert 1e-6 < np.abs(np.median(off, axis=0)).max() < 0.002


def test_without_a_picture_or_a_common_plane_nothing_is_tracked(scene: Scene) -> None:
    room, sights, _ = scene
    assert find_tracks([sights[0], None], [tuple(range(6))] * 2, room) == ()
    assert find_tracks(sights, [tuple(range(6)), (-1,) * 6], room) == ()
