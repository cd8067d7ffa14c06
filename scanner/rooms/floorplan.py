"""A room's floor plan: walls as lines, their corners, and every length, height and angle ± sigma.

A wall is an upright plane with nothing visible behind it; other upright planes are furniture. A wall ends where its
visible part ends, or at the nearest other wall, if the gap is less than half of the visible lengths.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from calib.numerics import Floats, Ints
from calib.rooms import Measured, angle_deg, distance, gap, vertex
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.upright import ceiling_of, is_vertical

_LEAST_OF_LARGEST = 0.04  # share of the largest upright plane's area
_BEHIND, _MOST_BEHIND = 0.02, 0.25  # distance over the room's size; share of the points on the wall
_ENDS = (1.0, 99.0)  # percentiles
_SAMPLE, _FEWEST = 20_000, 20  # points per station; points per wall
_MEET_DEG = 20.0
_LONGEST_GAP = 0.5  # relative to the visible lengths of both walls


@dataclass(frozen=True, eq=False)
class WallLine:
    """Upright plane number `plane` as seen from above: from `start` to `end` (2,), the room to the left of it.

    `corners`: at start and end the corner's number, None where the wall's end was not seen. `length`: between corners.
    """

    plane: int
    start: Floats
    end: Floats
    is_wall: bool
    corners: tuple[int | None, int | None] = (None, None)
    length: Measured | None = None


@dataclass(frozen=True, eq=False)
class PlanCorner:
    """Where two walls meet, (2,), and the angle inside the room between them, in degrees."""

    position: Floats
    planes: tuple[int, int]
    angle_deg: Measured


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """In the room's frame and `unit`. `height`: from floor to ceiling, None where one of them was not seen.

    `gaps`: walls that face each other, and how far they are apart. `cameras` (S, 2) and `ahead` (S, 2): stations, and
    where they look.
    """

    lines: tuple[WallLine, ...]
    corners: tuple[PlanCorner, ...]
    gaps: tuple[tuple[int, int, Measured], ...]
    height: Measured | None
    cameras: Floats
    ahead: Floats
    unit: str


def floor_plan(room: SolvedRoom) -> FloorPlan:
    """Of a solved room."""
    lines = _lines(room)
    walls = [line for line in lines if line.is_wall]
    corners, joined = _joined(room, walls)
    facing = [
        (first.plane, second.plane, _scaled(gap(room.estimate, first.plane, second.plane), room.factor))
        for first, second in combinations(walls, 2)
        if room.planes[first.plane].normal @ room.planes[second.plane].normal < -np.cos(np.radians(_MEET_DEG))
    ]
    ceiling = ceiling_of(room.planes, room.areas)
    height = None
    if room.floor is not None and ceiling is not None:
        height = _scaled(gap(room.estimate, room.floor, ceiling), room.factor)
    return FloorPlan(
        (*joined, *(line for line in lines if not line.is_wall)),
        corners,
        tuple(facing),
        height,
        np.array([station.place.translation[:2] for station in room.stations]),
        np.array([station.place.rotation[:2, 2] for station in room.stations]),
        room.unit,
    )


def _scaled(measured: Measured, factor: float) -> Measured:
    return Measured(factor * measured.value, factor * measured.sigma)


def _lines(room: SolvedRoom) -> list[WallLine]:
    points, plane = _sampled(room)
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    vertical = [i for i, plane in enumerate(room.planes) if is_vertical(plane)]
    largest = max((room.areas[i] for i in vertical), default=0.0)
    walls = []
    for i in vertical:
        own = points[plane == i]
        if room.areas[i] < _LEAST_OF_LARGEST * largest or len(own) < _FEWEST:
            continue
        normal = room.planes[i].normal[:2] / np.linalg.norm(room.planes[i].normal[:2])
        along = np.array([normal[1], -normal[0]])  # the room is on the left, where the normal points
        low, high = np.percentile(own[:, :2] @ along, _ENDS)
        middle = own[:, :2].mean(axis=0)
        start, end = (middle + (place - middle @ along) * along for place in (low, high))
        behind = points @ room.planes[i].normal < room.planes[i].offset - _BEHIND * size
        beside = (points[:, :2] @ along > low) & (points[:, :2] @ along < high)
        if np.count_nonzero(behind & beside) < _MOST_BEHIND * len(own):
            walls.append(WallLine(i, start, end, True))
        else:
            for first, last in _pieces(own[:, :2] @ along, _BEHIND * size):
                walls.append(WallLine(i, start + (first - low) * along, start + (last - low) * along, False))
    return walls


def _pieces(places: Floats, gap: float) -> list[tuple[float, float]]:
    """Stretches of a line on which points are, with no `gap` between them."""
    places = np.sort(places)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(places) > gap) + 1, [len(places)]])
    return [
        (float(places[first]), float(places[end - 1]))
        for first, end in pairwise(starts.tolist())
        if end - first >= _FEWEST and places[end - 1] - places[first] > gap
    ]


def _sampled(room: SolvedRoom) -> tuple[Floats, Ints]:
    """Points (M, 3) of the room, evenly over the stations' pictures, and the plane (M,) that each is on."""
    points, plane = [], []
    for station in room.stations:
        there = np.flatnonzero(station.cloud.there)
        chosen = there[:: max(1, len(there) // _SAMPLE)]
        points.append(station.to_room(station.cloud.points.reshape(-1, 3)[chosen].astype(np.float64)))
        plane.append(station.plane.ravel()[chosen])
    return np.concatenate(points), np.concatenate(plane)


def _joined(room: SolvedRoom, walls: Sequence[WallLine]) -> tuple[tuple[PlanCorner, ...], list[WallLine]]:
    """Corners where ends of walls meet, the nearest ends first; and the walls with what that makes of them."""
    candidates = []
    for i, j in combinations(range(len(walls)), 2):
        crossing = _crossing(walls[i], walls[j])
        if crossing is not None:
            ends = [_nearer_end(wall, crossing) for wall in (walls[i], walls[j])]
            visible = sum(float(np.linalg.norm(wall.end - wall.start)) for wall in (walls[i], walls[j]))
            missing = sum(missed for _, missed in ends)
            candidates.append((missing / visible, (i, ends[0][0]), (j, ends[1][0])))
    taken: dict[tuple[int, int], int] = {}
    corners: list[PlanCorner] = []
    for missing, first, second in sorted(candidates):
        if missing < _LONGEST_GAP and first not in taken and second not in taken:
            taken[first] = taken[second] = len(corners)
            corners.append(_corner(room, walls[first[0]], walls[second[0]]))
    joined = []
    for i, wall in enumerate(walls):
        at = taken.get((i, 0)), taken.get((i, 1))
        start, end = (
            (wall.start, wall.end)
            if at == (None, None)
            else (
                wall.start if at[0] is None else corners[at[0]].position,
                wall.end if at[1] is None else corners[at[1]].position,
            )
        )
        joined.append(replace(wall, start=start, end=end, corners=at, length=_length(room, corners, at)))
    return tuple(corners), joined


def _crossing(wall: WallLine, next_wall: WallLine) -> Floats | None:
    """Where two lines cross, (2,); None if they are nearly parallel."""
    first, second = wall.end - wall.start, next_wall.end - next_wall.start
    turn = float(first[0] * second[1] - first[1] * second[0])
    if abs(turn) < np.sin(np.radians(_MEET_DEG)) * np.linalg.norm(first) * np.linalg.norm(second):
        return None
    apart = next_wall.start - wall.start
    return wall.start + first * float(apart[0] * second[1] - apart[1] * second[0]) / turn


def _nearer_end(wall: WallLine, point: Floats) -> tuple[int, float]:
    """0 for the start, 1 for the end, and how far that is from a point."""
    apart = [float(np.linalg.norm(end - point)) for end in (wall.start, wall.end)]
    return int(np.argmin(apart)), min(apart)


def _corner(room: SolvedRoom, first: WallLine, second: WallLine) -> PlanCorner:
    angle = angle_deg(room.estimate, first.plane, second.plane)
    position = _crossing(first, second)
    assert position is not None  # a candidate has one
    if room.floor is not None:
        at = vertex(room.estimate, first.plane, second.plane, room.floor).position
        position = room.factor * (room.upright.rotation @ at + room.upright.translation)[:2]
    return PlanCorner(position, (first.plane, second.plane), angle)


def _length(room: SolvedRoom, corners: Sequence[PlanCorner], at: tuple[int | None, int | None]) -> Measured | None:
    """Between the corners at a wall's ends, along the floor."""
    if at[0] is None or at[1] is None or room.floor is None:
        return None
    ends = [vertex(room.estimate, *corners[corner].planes, room.floor) for corner in at if corner is not None]
    return _scaled(distance(room.estimate, *ends), room.factor)
