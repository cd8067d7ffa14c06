from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from calib.geometry import Matches
from calib.numerics import Floats
from calib.rooms import Room, RoomEstimate, lengths
from calib.rooms.lengths import Measured, RoomPoint
from tests.calib.rooms.conftest import Case
from tests.support.numeric import gradient_of


def at(found: RoomEstimate, room: Room) -> RoomEstimate:
    """The estimate with this room as its solution."""
    return replace(found, fit=replace(found.fit, layout=room))


def sigma_by_differences(found: RoomEstimate, value: Callable[[RoomEstimate], float]) -> float:
    gradient = gradient_of(lambda room: np.array(value(at(found, room))), found.room)
    return float(np.sqrt(gradient @ found.covariance @ gradient))


def facing(room: Room) -> tuple[int, int]:
    pairs = combinations(range(len(room.planes)), 2)
    return min(pairs, key=lambda pair: float(room.planes[pair[0]].normal @ room.planes[pair[1]].normal))


def crossing(room: Room) -> tuple[int, int, int]:
    normals = [plane.normal for plane in room.planes]
    triples = combinations(range(len(normals)), 3)
    return max(triples, key=lambda triple: abs(np.linalg.det(np.stack([normals[i] for i in triple]))))


def some_points(case: Case) -> list[Callable[[RoomEstimate], RoomPoint]]:
    cells, plane = case.cells[1], int(case.cells[1].plane[0])
    pixel = float(cells.camera_px[0, 0]), float(cells.camera_px[0, 1])
    part = Matches(cells.camera_px[:20], cells.projector_px[:20])
    return [
        lambda found: lengths.vertex(found, *crossing(case.truth)),
        lambda found: lengths.point_on_plane(found, 1, pixel, case.plane_of[1][plane]),
        lambda found: lengths.middle_of(found, 2, part),
    ]


def test_sigmas_of_angles_and_gaps_match_their_derivatives(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    pair = facing(case.truth)
    centres = {plane: lengths.centre_of(case.found, plane) for plane in range(len(case.truth.planes))}
    monkeypatch.setattr(lengths, "centre_of", lambda _, plane: centres[plane])  # where it is taken does not move
    first, second, _ = crossing(case.truth)

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
    points = some_points(case)
    for a, b in combinations(range(2), 2):
        measured = lengths.distance(case.found, points[a](case.found), points[b](case.found))
        true = at(case.found, case.truth)
        exact = lengths.distance(case.found, points[a](true), points[b](true)).value
        assert 0 < measured.sigma < 0.01 * measured.value
        assert abs(measured.value - exact) < 4 * measured.sigma


def test_further_matches_add_their_own_noise(case: Case) -> None:
    station, cells = 2, case.cells[2]
    one = Matches(cells.camera_px[:1], cells.projector_px[:1])
    many = Matches(np.repeat(one.camera_px, 4, axis=0), np.repeat(one.projector_px, 4, axis=0))
    alone, together = (lengths.middle_of(case.found, station, each) for each in (one, many))
    assert np.allclose(alone.position, together.position)
    assert np.trace(alone.own) == pytest.approx(4 * np.trace(together.own))
    assert np.all(lengths.sigmas_of_point(case.found, alone) > lengths.sigmas_of_point(case.found, together))


def test_angles_between_parallel_planes_have_a_sigma(case: Case) -> None:
    pair = facing(case.truth)
    normal: Floats = case.found.planes[pair[0]].normal
    planes = list(case.found.planes)
    planes[pair[1]] = replace(planes[pair[1]], normal=-normal)
    measured = lengths.angle_deg(at(case.found, replace(case.found.room, planes=tuple(planes))), *pair)
    assert measured.value == pytest.approx(0.0, abs=1e-6)
    assert 0 < measured.sigma < 1
