"""Reasons why a capture is no station of a room, from its surfaces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.finding import Finding, Severity
from calib.geometry import Pose
from calib.registration import ANOTHER_ROOM, NO_OVERLAP, Group, Registration, UnregisteredStation
from scanner.capture import CaptureMetadata
from scanner.results import Decoded, GivenMatches
from scanner.rooms import CHANGED_RIG
from scanner.rooms.contents import OutlierStation, Station
from scanner.rooms.epipolar_lines import outlier_stations_of, widest_unseen_deg
from tests.scanner.rooms.conftest import CAMERA, SolvedExample
from tests.support.whole_room import TrueStation, stations

NOTHING = UnregisteredStation(0, Finding(NO_OVERLAP, Severity.WARNING, "it shows nothing that another station shows"))


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
    off = Finding(CHANGED_RIG, Severity.WARNING, "its matches are off the epipolar lines", data={"off_px": 2.0})
    found = said(example, decoded(other), UnregisteredStation(0, off))
    assert found.finding.kind == CHANGED_RIG
    assert found.finding.message == "its rig was changed: its matches are off the epipolar lines"
    assert found.finding.data == {"off_px": 2.0}


def test_a_station_without_common_surfaces_has_no_overlap(example: SolvedExample, other: TrueStation) -> None:
    found = said(example, decoded(other))
    assert found.finding == NOTHING.finding
    assert found.warning.message == "odd is left out: it shows nothing that another station shows."


def test_after_a_full_circle_a_station_without_overlap_is_of_another_room(
    example: SolvedExample, other: TrueStation
) -> None:
    assert 30 < widest_unseen_deg(example.solved.stations) < 250
    assert 0 < widest_unseen_deg(all_round(example)) < 20
    found = said(example, decoded(other), of=all_round(example))
    assert found.finding.kind == ANOTHER_ROOM


def test_free_space_violations_indicate_another_room(example: SolvedExample, other: TrueStation) -> None:
    seen_through = Finding(ANOTHER_ROOM, Severity.WARNING, "40% of them are in free space: it is of another room")
    assert said(example, decoded(other), UnregisteredStation(0, seen_through)).finding == seen_through


def test_the_members_of_another_group_are_named(example: SolvedExample, other: TrueStation) -> None:
    group = example.solved.group
    second = Group((0, 1), group.places[:2], (), ((), ()), (), np.inf)
    captures = [decoded(other), decoded(other)]
    registration = Registration((group, second), (), ())
    found = outlier_stations_of(registration, captures, example.solved.calibration, example.solved.stations)
    assert [each.finding.kind for each in found] == [NO_OVERLAP, NO_OVERLAP]
    assert all("with odd, odd" in each.finding.message for each in found)
