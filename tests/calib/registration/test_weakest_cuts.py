"""Weak connections within a group of stations, and outlier stations."""

import numpy as np
import pytest

from calib.geometry import Pose
from calib.registration import SOMETHING_MOVED
from calib.registration.agreement import DECIDED_NATS
from calib.registration.alignment import align_jointly
from calib.registration.assembly import gain_of
from calib.registration.group_evidence import firmly_connected, weakest_cut, worst_misfit
from calib.registration.range_view import Surfaces, surfaces_of
from calib.synthetic import moved_rig
from tests.calib.registration.test_register import stations_in, view_of

pytestmark = pytest.mark.xdist_group("registration")  # shares its stations

Scene = tuple[dict[int, Surfaces], dict[int, Pose]]


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Four stations in a row, and where they stood."""
    _, stations = stations_in(0, 4)
    return {k: surfaces_of(view_of(station)) for k, station in enumerate(stations)}, {
        k: station.place for k, station in enumerate(stations)
    }


def test_stations_of_a_room_are_firmly_connected(scene: Scene) -> None:
    surfaces, places = scene
    cut = weakest_cut(surfaces, places)
    assert 1 <= len(cut.part) <= 2
    assert DECIDED_NATS < cut.nats < 60
    assert firmly_connected(surfaces, places) == places


def test_halves_without_common_surfaces_are_separated(scene: Scene) -> None:
    surfaces, places = scene
    far = {k: Pose(at.rotation, at.translation + np.array([100.0 * (k > 1), 0, 0])) for k, at in places.items()}
    for k in far:
        others = {m: at for m, at in far.items() if m != k}
        assert gain_of(surfaces, others, k, far[k]) > DECIDED_NATS
    cut = weakest_cut(surfaces, far)
    assert cut.part in {(0, 1), (2, 3)}
    assert -25 < cut.nats < -10  # nothing is shared, and a place costs 17
    assert len(firmly_connected(surfaces, far)) == 2


def test_the_middle_of_three_stations_in_a_row_is_no_outlier(scene: Scene) -> None:
    surfaces, places = scene
    worst = worst_misfit(surfaces, {k: places[k] for k in (1, 2, 3)})
    assert worst is not None
    assert worst.finding is None
    assert 0.5 < worst.times_worse < 1.5


def test_a_changed_rig_is_the_outlier(scene: Scene) -> None:
    surfaces, places = scene
    _, stations = stations_in(0, 4)
    changed = {**surfaces, 1: surfaces_of(view_of(moved_rig(stations[1], 0.08)))}
    worst = worst_misfit(changed, align_jointly(changed, places))
    assert worst is not None
    assert worst.station == 1
    assert worst.finding is not None
    assert worst.finding.kind == SOMETHING_MOVED
    assert 2 < worst.times_worse < 10
