"""Registration of stations of synthetic rooms, compared with their true poses."""

from functools import cache

import numpy as np
import pytest

from calib.geometry import Intrinsics, Pose
from calib.numerics import Floats
from calib.pointcloud import surface
from calib.registration import ANOTHER_ROOM, NO_OVERLAP, NOTHING_SEEN, Registration, StationView, register, station_view
from calib.registration.hypotheses import shape_poses
from calib.registration.range_view import surfaces_of
from calib.synthetic import FurnishedRoom, StationCloud, moved_rig, random_furnished_room, ring, seen_from

pytestmark = pytest.mark.xdist_group("registration")  # what the module shares is made once

CAMERA = Intrinsics(306, 256, (225.0, 225.0), (154.0, 125.5), (-0.06, 0.01, 0.0, 0.0, 0.0))


@cache
def stations_in(seed: int, count: int, pieces: int = 8) -> tuple[FurnishedRoom, list[StationCloud]]:
    rng = np.random.default_rng(seed)
    room = random_furnished_room(rng, pieces)
    places = ring(rng, room, 6)[:count]
    return room, [seen_from(room, place, rng, camera=CAMERA) for place in places]


def view_of(station: StationCloud, factor: float = 1.0) -> StationView:
    points = (factor * station.points).astype(np.float32)
    return station_view(points, surface(points, CAMERA.focal_px[0]).normals, CAMERA)


def off(found: Pose, true: Pose) -> tuple[float, float]:
    """Errors in degrees and metres."""
    step = true.inverse() @ found
    angle = np.degrees(np.arccos(np.clip((np.trace(step.rotation) - 1) / 2, -1, 1)))
    return float(angle), float(np.linalg.norm(step.translation))


@pytest.fixture(scope="module")
def scene() -> tuple[FurnishedRoom, list[StationCloud]]:
    return stations_in(0, 4)


@pytest.fixture(scope="module")
def views(scene: tuple[FurnishedRoom, list[StationCloud]]) -> list[StationView]:
    return [view_of(station) for station in scene[1]]


@pytest.fixture(scope="module")
def with_a_stranger(views: list[StationView]) -> Registration:
    """Stations 1, 0 and 2 of a room, and between them one of another room."""
    stranger = view_of(stations_in(5, 1)[1][0])
    return register([views[1], stranger, views[0], views[2]])


def test_stations_are_registered_and_an_outlier_station_is_left_out(
    scene: tuple[FurnishedRoom, list[StationCloud]], with_a_stranger: Registration
) -> None:
    (group,) = with_a_stranger.groups
    assert group.stations == (0, 2, 3)
    assert not group.ambiguous
    (left,) = with_a_stranger.left_out
    assert left.station == 1
    assert left.finding.kind in (NO_OVERLAP, ANOTHER_ROOM)
    stood = [scene[1][k].place for k in (1, 0, 2)]
    for found, true in zip(group.places[1:], stood[1:], strict=True):
        degrees, metres = off(found, stood[0].inverse() @ true)
        # What the calibration is off bends the walls by some millimetres.
        assert 1e-4 < degrees < 0.6
        assert 1e-4 < metres < 0.05


def test_neighbouring_stations_overlap_by_a_stated_share(with_a_stranger: Registration) -> None:
    pairs = {(pair.first, pair.second): pair for pair in with_a_stranger.pairs}
    for neighbours in ((0, 2), (0, 3)):  # stations 0–1 and 1–2 of the room
        pair = pairs[neighbours]
        assert 0.2 < pair.overlap < 0.7
        assert 0 <= pair.contradiction < 0.02
        assert 2e-4 < pair.residual < 4e-3
    assert all(1 not in pair for pair in pairs)


def test_shared_walls_have_their_true_planes(
    scene: tuple[FurnishedRoom, list[StationCloud]], with_a_stranger: Registration
) -> None:
    room, stations = scene
    (group,) = with_a_stranger.groups
    seen_by = np.bincount([p for planes in group.plane_of for p in planes if p >= 0], minlength=len(group.planes))
    floor = [plane for plane, count in zip(group.planes, seen_by, strict=True) if count == 3]
    assert floor
    stood = stations[1].place

    def apart(normal: Floats, height: float) -> tuple[float, float]:
        in_room = stood.rotation.T @ normal
        own = height - float(normal @ stood.translation)
        nearest = max(floor, key=lambda plane: float(plane.normal @ in_room))
        return float(np.degrees(np.arccos(np.clip(nearest.normal @ in_room, -1, 1)))), abs(nearest.offset - own)

    normals, heights = room.scene.solids[0]
    degrees, metres = apart(normals[2], float(heights[2]))
    assert 1e-5 < degrees < 0.6
    assert 1e-6 < metres < 0.02


def test_the_unit_does_not_matter(scene: tuple[FurnishedRoom, list[StationCloud]], views: list[StationView]) -> None:
    one = register(views[:2])
    (group,), (other,) = one.groups, register([view_of(station, 12.5) for station in scene[1][:2]]).groups
    step = off(Pose(other.places[1].rotation, other.places[1].translation / 12.5), group.places[1])
    assert step[0] < 0.05
    assert step[1] < 0.005


def test_changed_extrinsics_are_named(
    scene: tuple[FurnishedRoom, list[StationCloud]], views: list[StationView]
) -> None:
    found = register([*views[:2], view_of(moved_rig(scene[1][2], 0.1)), views[3]])
    assert all(2 not in group.stations for group in found.groups)
    assert 2 in {left.station for left in found.left_out}


def test_a_bare_room_is_ambiguous() -> None:
    _, stations = stations_in(3, 2, pieces=0)
    (group,) = register([view_of(station) for station in stations]).groups
    assert group.ambiguous
    assert group.ahead_nats < 7
    for alternative in group.alternatives:
        assert len(alternative.places) == len(group.stations)


def test_stations_without_points_have_no_overlap(views: list[StationView]) -> None:
    nothing = np.full((CAMERA.height, CAMERA.width, 3), np.nan, np.float32)
    found = register([views[0], station_view(nothing, nothing, CAMERA)])
    assert not found.groups
    assert not found.pairs
    assert [left.station for left in found.left_out] == [0, 1]
    assert found.left_out[1].finding.kind == NOTHING_SEEN


def test_without_open3d_the_message_names_what_to_install(
    views: list[StationView], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> object:
        raise OSError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr("calib.deferred_imports.import_module", missing)
    with pytest.raises(ImportError, match=r"libGL\.so\.1.*apt-get install libgl1 .*libgomp1"):
        shape_poses(surfaces_of(views[0]), surfaces_of(views[1]))


def test_arrays_of_another_size_are_an_error(views: list[StationView]) -> None:
    with pytest.raises(ValueError, match=r"\(256, 306, 3\)"):
        station_view(views[0].points[1:], views[0].normals, CAMERA)
