from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from calib.numerics import Floats
from calib.rooms import Room, RoomEstimate, lengths
from calib.rooms.lengths import Measured, RoomPoint
from tests.calib.rooms.conftest import Case
from tests.support.states import gradient_of


def at(found: RoomEstimate, room: Room) -> RoomEstimate:
    """The estimate with this room as its solution."""
    return replace(found, fit=replace(found.fit, state=room))


def sigma_by_differences(found: RoomEstimate, value: Callable[[RoomEstimate], float]) -> float:
    gradient = gradient_of(lambda room: np.array(value(at(found, room))), found.room)
    return float(np.sqrt(gradient @ found.covariance @ gradient))


def facing(room: Room) -> tuple[int, int]:
    pairs = combinations(range(len(room.planes)), 2)
    return min(pairs, key=lambda pair: float(room.planes[pair[0]].normal @ room.planes[pair[1]].normal))


def crossings(room: Room) -> list[tuple[int, int, int]]:
    """Planes that meet in a point, the most nearly perpendicular first."""
    normals = [plane.normal for plane in room.planes]
    triples = combinations(range(len(normals)), 3)
    return sorted(triples, key=lambda triple: -abs(np.linalg.det(np.stack([normals[i] for i in triple]))))


def some_points(case: Case) -> list[Callable[[RoomEstimate], RoomPoint]]:
    """The ends of an edge between two walls that face each other."""
    one, other = facing(case.truth)
    edge = next({*triple} - {one} for triple in crossings(case.truth) if one in triple and other not in triple)
    return [lambda found: lengths.vertex(found, one, *edge), lambda found: lengths.vertex(found, other, *edge)]


def test_sigmas_of_angles_and_gaps_match_their_derivatives(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    pair = facing(case.truth)
    centres = {plane: lengths.centre_of(case.found, plane) for plane in range(len(case.truth.planes))}
    monkeypatch.setattr(lengths, "centre_of", lambda _, plane: centres[plane])  # where it is taken does not move
    first, second, _ = crossings(case.truth)[0]

    def check(measure: Callable[[RoomEstimate], Measured]) -> None:
        by_differences = sigma_by_differences(case.found, lambda found: measure(found).value)
        assert measure(case.found).sigma == pytest.approx(by_differences, rel=1e-3)

    check(lambda found: lengths.gap(found, *pair))
    check(lambda found: lengths.angle_deg(found, first, second))


def test_points_follow_the_room(case: Case) -> None:
    def check(point: Callable[[RoomEstimate], RoomPoint]) -> None:
        by_room = point(case.found).by_room
        some = [*np.flatnonzero(by_room.any(axis=0)), *range(0, case.found.room.size, 7)]
        numeric = gradient_of(lambda room: point(at(case.found, room)).position, case.found.room, some)
        assert np.allclose(by_room[:, some], numeric, atol=1e-5 * np.abs(numeric).max())

    for each in some_points(case):
        check(each)


def test_errors_of_distances_match_their_sigmas(case: Case) -> None:
    first, second = some_points(case)
    measured = lengths.distance(case.found, first(case.found), second(case.found))
    true = at(case.found, case.truth)
    exact = lengths.distance(case.found, first(true), second(true)).value
    assert 0 < measured.sigma < 0.01 * measured.value
    assert abs(measured.value - exact) < 4 * measured.sigma


def test_angles_between_parallel_planes_have_a_sigma(case: Case) -> None:
    pair = facing(case.truth)
    normal: Floats = case.found.room.planes[pair[0]].normal
    planes = list(case.found.room.planes)
    planes[pair[1]] = replace(planes[pair[1]], normal=-normal)
    measured = lengths.angle_deg(at(case.found, replace(case.found.room, planes=tuple(planes))), *pair)
    assert measured.value == pytest.approx(0.0, abs=1e-6)
    assert 0 < measured.sigma < 1
