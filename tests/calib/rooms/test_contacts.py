import numpy as np
import pytest

from calib.geometry import Matches
from calib.rooms import RoomEstimate
from calib.rooms.factors import Contact, find_contacts
from tests.calib.rooms.conftest import Case, case_of
from tests.support.states import gradient_of

NOISE_PX = 0.05


@pytest.fixture(scope="module")
def balls() -> Case:
    """A room with balls in its middle, which the stations see from different sides."""
    return case_of(4, balls=8, count=15_000)


def loose_of(case: Case) -> list[Matches]:
    return [station.matches[station.matches.labels < 0] for station in case.made.stations]


def contacts_of(case: Case) -> tuple[Contact, ...]:
    radius = 0.02 / case.made.calibration.baseline
    return find_contacts(loose_of(case), case.truth, [NOISE_PX] * len(case.cells), radius)


def with_balls(case: Case) -> RoomEstimate:
    return case.estimate(
        loose=loose_of(case),
    )


def test_points_in_contact_lie_on_one_surface(balls: Case) -> None:
    contacts = contacts_of(balls)
    assert len(contacts) >= 3
    for contact in contacts:
        assert np.allclose(np.linalg.norm(contact.normals, axis=1), 1.0)
        distances, _, _ = contact.distances(balls.truth)
        assert np.median(np.abs(distances)) * balls.made.calibration.baseline < 0.002
        assert 0.3 < np.median(np.abs(distances) / np.sqrt(contact.variance)) / 0.6745 < 1.5


def test_derivatives_of_distances_match_differences(balls: Case) -> None:
    contact = contacts_of(balls)[0]
    columns = contact.columns(balls.start).tolist()
    _, by_room, _ = contact.distances(balls.start)
    numeric = gradient_of(lambda room: contact.distances(room)[0], balls.start, columns)
    assert np.allclose(by_room, numeric, atol=1e-5 * np.abs(numeric).max())


def test_the_gradient_matches_the_misfit(balls: Case) -> None:
    contact = contacts_of(balls)[0]
    columns = contact.columns(balls.start).tolist()
    gradient = contact.misfit(balls.start).gradient
    numeric = gradient_of(lambda room: np.array(contact.misfit(room).cost), balls.start, columns) / 2
    assert np.allclose(gradient, numeric, atol=1e-4 * np.abs(numeric).max())


def test_curved_surfaces_reduce_pose_sigmas_without_bias(balls: Case) -> None:
    found = with_balls(balls)
    off = []
    for station in range(1, len(balls.truth.places)):
        surer, before = (np.trace(each.place_covariance(station)[3:, 3:]) for each in (found, balls.found))
        assert surer < 1.05 * before
        apart = found.room.places[station].translation - balls.truth.places[station].translation
        off.append(apart @ np.linalg.solve(found.place_covariance(station)[3:, 3:], apart))
    assert len(found.contacts) >= 3
    assert 0.3 < np.sqrt(np.mean(off) / 3) < 2.5


def test_stations_without_a_common_surface_have_no_contact(balls: Case) -> None:
    few = [matches[:10] for matches in loose_of(balls)]
    assert find_contacts(few, balls.truth, [NOISE_PX] * len(few), 1.0) == ()
