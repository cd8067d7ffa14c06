"""A room's floor plan: walls as lines, their corners, and every length, height and angle ± sigma; as SVG, inside the
page and as a file, and as DXF in the room's unit, by ezdxf.

A wall is an upright plane with nothing visible behind it; other upright planes are furniture. A wall ends where its
visible part ends, or at the nearest other wall, if the gap is less than half of the visible lengths.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
from markupsafe import Markup, escape

from calib.numerics import Floats, Ints
from calib.rooms import Measured, angle_deg, distance, gap, vertex
from scanner.quantities import plain, shown_unit
from scanner.rooms.contents import SolvedRoom
from scanner.rooms.upright import ceiling_of, is_vertical

_LEAST_OF_LARGEST = 0.04  # share of the largest upright plane's area
_BEHIND, _MOST_BEHIND = 0.02, 0.25  # distance over the room's size; share of the points on the wall
_ENDS = (1.0, 99.0)  # percentiles
_SAMPLE, _FEWEST = 20_000, 20  # points per station; points per wall
_MEET_DEG = 20.0
_LONGEST_GAP = 0.5  # relative to the visible lengths of both walls
_WIDTH, _MARGIN = 900, 90
_STYLE = (
    "text{font:15px system-ui,sans-serif;fill:#222}.wall{stroke:#222;stroke-width:5;stroke-linecap:round}"
    ".thing{stroke:#8a8a8a;stroke-width:2.5;stroke-linecap:round}.ahead{stroke:#0072b2;stroke-width:2}"
    ".camera{fill:#0072b2}.quiet{font-size:13px;fill:#666}.station{fill:#0072b2;font-size:14px}"
)


@dataclass(frozen=True, eq=False)
class WallLine:
    """An upright plane as seen from above, the room to the left of it."""

    plane: int
    """Its number."""
    start: Floats
    """(2,)."""
    end: Floats
    """(2,)."""
    is_wall: bool
    corners: tuple[int | None, int | None] = (None, None)
    """At start and end the corner's number, None where the wall's end was not seen."""
    length: Measured | None = None
    """Between corners."""


@dataclass(frozen=True, eq=False)
class PlanCorner:
    """Where two walls meet, (2,), and the angle inside the room between them, in degrees."""

    position: Floats
    planes: tuple[int, int]
    angle_deg: Measured


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """A floor plan in the room's frame and `unit`."""

    lines: tuple[WallLine, ...]
    corners: tuple[PlanCorner, ...]
    gaps: tuple[tuple[int, int, Measured], ...]
    """Walls that face each other, and how far they are apart."""
    height: Measured | None
    """From floor to ceiling, None where one of them was not seen."""
    cameras: Floats
    """Places of the stations, (S, 2)."""
    ahead: Floats
    """Where they look, (S, 2)."""
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


def plan_svg(plan: FloorPlan, *, standalone: bool = False) -> Markup:
    """The plan; `standalone`: as a file, with its own namespace and a white page."""
    drawing = _Drawing(plan)
    inside = "".join(drawing.parts())
    alone = 'xmlns="http://www.w3.org/2000/svg" ' if standalone else ""
    page = f'<rect width="{_WIDTH}" height="{drawing.height:.0f}" fill="#fff"/>'
    return Markup(
        f'<svg {alone}role="img" aria-label="floor plan" viewBox="0 0 {_WIDTH} {drawing.height:.0f}">'
        f"<style>{_STYLE}</style>{page}{inside}</svg>"
    )


class _Drawing:
    def __init__(self, plan: FloorPlan) -> None:
        self._plan, self._unit = plan, shown_unit(plan.unit)
        ends = [end for line in plan.lines for end in (line.start, line.end)]
        every = np.array([*ends, *plan.cameras])
        self._low, high = every.min(axis=0), every.max(axis=0)
        extent = np.maximum(high - self._low, 1e-9)
        self._scale = (_WIDTH - 2 * _MARGIN) / float(extent[0])
        self.height = 2 * _MARGIN + self._scale * float(extent[1])

    def _at(self, point: Floats) -> tuple[float, float]:
        """Where a point (2,) of the room is on the page: y is up in the room."""
        x, y = (point - self._low) * self._scale
        return _MARGIN + float(x), self.height - _MARGIN - float(y)

    def parts(self) -> Iterator[str]:
        """From below to above."""
        for line in self._plan.lines:
            yield self._segment("wall" if line.is_wall else "thing", line.start, line.end)
        for line in self._plan.lines:
            if line.length is not None:
                yield self._dimension(line, line.length)
        for line in self._plan.lines:
            yield self._number(line)
        for corner in self._plan.corners:
            yield self._angle(corner.position, corner.angle_deg)
        for number, (camera, ahead) in enumerate(zip(self._plan.cameras, self._plan.ahead, strict=True), start=1):
            yield self._segment("ahead", camera, camera + 30 / self._scale * ahead / np.linalg.norm(ahead))
            x, y = self._at(camera)
            yield f'<circle class="camera" cx="{x:.1f}" cy="{y:.1f}" r="6"/>'
            yield self._text(x, y + 22, str(number), "station")
        if self._plan.height is not None:
            height = self._unit.length(self._plan.height.value, self._plan.height.sigma)
            yield self._text(_WIDTH / 2, 24, f"from floor to ceiling {height}", "quiet")

    def _segment(self, kind: str, start: Floats, end: Floats) -> str:
        (x1, y1), (x2, y2) = self._at(start), self._at(end)
        return f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'

    def _dimension(self, line: WallLine, length: Measured) -> str:
        """Outside of the wall, along it; never upside down."""
        along = (line.end - line.start) / np.linalg.norm(line.end - line.start)
        outside = np.array([along[1], -along[0]])  # the room is on the left
        x, y = self._at((line.start + line.end) / 2 + 26 / self._scale * outside)
        turn = -float(np.degrees(np.arctan2(along[1], along[0])))
        turn = (turn + 90.001) % 180 - 90.001
        text = escape(self._unit.length(length.value, length.sigma))
        return (
            f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle" dominant-baseline="middle" '
            f'transform="rotate({turn:.1f} {x:.1f} {y:.1f})">{text}</text>'
        )

    def _number(self, line: WallLine) -> str:
        """The plane's, beside its middle, towards the room."""
        along = (line.end - line.start) / np.linalg.norm(line.end - line.start)
        inside = np.array([-along[1], along[0]])  # the room is on the left
        x, y = self._at((line.start + line.end) / 2 + 14 / self._scale * inside)
        return self._text(x, y + 4, str(line.plane), "quiet")

    def _angle(self, corner: Floats, angle: Measured) -> str:
        middle = np.mean([end for line in self._plan.lines for end in (line.start, line.end)], axis=0)
        inward = (middle - corner) / max(float(np.linalg.norm(middle - corner)), 1e-9)
        x, y = self._at(corner + 100 / self._scale * inward)
        decimals = max(0, int(np.ceil(-np.log10(max(angle.sigma, 1e-6)))) + 1) if np.isfinite(angle.sigma) else 1
        return self._text(x, y, f"{plain(angle.value, decimals)} ± {plain(angle.sigma, decimals)}°", "quiet")

    @staticmethod
    def _text(x: float, y: float, text: str, kind: str) -> str:
        return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="middle">{escape(text)}</text>'


WALLS, FURNITURE, DIMENSIONS, STATIONS = "WALLS", "FURNITURE", "DIMENSIONS", "STATIONS"
_UNITS = {"in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6}  # $INSUNITS; 0 is none
_TEXT_OF_SIZE = 0.02


def write_dxf(path: Path, plan: FloorPlan) -> None:
    """Write the plan. Raises OSError."""
    from ezdxf.enums import TextEntityAlignment  # which takes long to load
    from ezdxf.filemanagement import new

    document = new("R2010", setup=True)
    document.header["$INSUNITS"] = _UNITS.get(plan.unit, 0)
    for layer, colour in ((WALLS, 7), (FURNITURE, 8), (DIMENSIONS, 3), (STATIONS, 5)):
        document.layers.add(layer, color=colour)
    space, unit = document.modelspace(), shown_unit(plan.unit)
    ends = np.array([*(end for line in plan.lines for end in (line.start, line.end)), *plan.cameras])
    height = _TEXT_OF_SIZE * max(float(np.ptp(ends, axis=0).max()), 1e-9)

    def text(words: str, at: Floats, layer: str, turn: float = 0.0) -> None:
        entity = space.add_text(words, height=height, rotation=turn, dxfattribs={"layer": layer})
        entity.set_placement((float(at[0]), float(at[1])), align=TextEntityAlignment.MIDDLE_CENTER)

    for line in plan.lines:
        layer = WALLS if line.is_wall else FURNITURE
        start, end = (tuple(point.tolist()) for point in (line.start, line.end))
        space.add_line(start, end, dxfattribs={"layer": layer})
        if line.length is not None:
            along = (line.end - line.start) / np.linalg.norm(line.end - line.start)
            turn = (float(np.degrees(np.arctan2(along[1], along[0]))) + 90.001) % 180 - 90.001
            outside = (line.start + line.end) / 2 + 1.5 * height * np.array([along[1], -along[0]])
            text(unit.length(line.length.value, line.length.sigma), outside, DIMENSIONS, turn)
    for corner in plan.corners:
        inward = ends.mean(axis=0) - corner.position
        angle = f"{plain(corner.angle_deg.value, 3)}° ± {plain(corner.angle_deg.sigma, 3)}°"
        text(angle, corner.position + 4 * height * inward / np.linalg.norm(inward), DIMENSIONS)
    for number, camera in enumerate(plan.cameras, start=1):
        space.add_circle(tuple(camera.tolist()), 0.7 * height, dxfattribs={"layer": STATIONS})
        text(str(number), camera + np.array([0.0, -1.8 * height]), STATIONS)
    document.saveas(path)
