"""Reasons why a capture is no station of a room, from its surfaces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.geometry import Pose
from calib.rooms import Group, Registration, UnregisteredStation
from scanner.capture import CaptureMetadata
from scanner.results import Decoded, GivenMatches
from scanner.rooms.contents import OutlierStation, Station
from scanner.rooms.outlier_stations import outlier_stations_of, widest_unseen_deg
from tests.scanner.rooms.conftest import CAMERA, SolvedExample
from tests.support.whole_room import TrueStation, stations

NOTHING = UnregisteredStation(0, "nothing shared", "it shows nothing that another station shows")


@pytest.fixture(scope="module")
def other() -> TrueStation:
    """A station of the room that is not in the example."""
    return stations(6, 1, camera=CAMERA, furniture_askew_deg=4.0)[5]


def decoded(station: TrueStation) -> Decoded:
    rig = station.calibration
    return Decoded(CaptureMetadata(rig.camera.size, rig.projector.size), station.matches, GivenMatches(), "odd")


def said(
    example: SolvedExample, capture: Decoded, left: UnregisteredStation = NOTHING, of: Sequence[Station] | None = None
) -> OutlierStation:
    registration = Registration((), (), (left,))
    (found,) = outlier_stations_of(registration, [capture], example.solved.calibration, of or example.solved.stations)
    return found


def all_round(example: SolvedExample) -> list[Station]:
    """The example's stations, and the same rotated to cover the full circle."""
    half = Pose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    found = list(example.solved.stations)
    for station in example.solved.stations:
        place = Pose(half.rotation @ station.place.rotation, half.rotation @ station.place.translation)
        found.append(replace(station, place=place))
    return found


def test_changed_extrinsics_are_named(example: SolvedExample, other: TrueStation) -> None:
    found = said(
        example, decoded(other), UnregisteredStation(0, "another rig", "its matches are off the epipolar lines")
    )
    assert found.cause == "changed rig"
    assert found.reason == "its rig was changed: its matches are off the epipolar lines"


def test_a_station_without_common_surfaces_has_no_overlap(example: SolvedExample, other: TrueStation) -> None:
    found = said(example, decoded(other))
    assert found.cause == "no overlap"
    assert found.reason == NOTHING.reason


def test_after_a_full_circle_a_station_without_overlap_is_of_another_room(
    example: SolvedExample, other: TrueStation
) -> None:
    assert 30 < widest_unseen_deg(example.solved.stations) < 250
    assert 0 < widest_unseen_deg(all_round(example)) < 20
    found = said(example, decoded(other), of=all_round(example))
    assert found.cause == "another room"


def test_free_space_violations_indicate_another_room(example: SolvedExample, other: TrueStation) -> None:
    left = UnregisteredStation(0, "free space", "40% of them are in free space: another room, or the rig was changed")
    found = said(example, decoded(other), left)
    assert found.cause == "another room"
    assert "40%" in found.reason
    assert "rig" not in found.reason


def test_the_members_of_another_group_are_named(example: SolvedExample, other: TrueStation) -> None:
    group = example.solved.group
    second = Group((0, 1), group.places[:2], (), ((), ()), (), np.inf)
    captures = [decoded(other), decoded(other)]
    registration = Registration((group, second), (), ())
    found = outlier_stations_of(registration, captures, example.solved.calibration, example.solved.stations)
    assert [each.cause for each in found] == ["no overlap", "no overlap"]
    assert all("with odd, odd" in each.reason for each in found)
