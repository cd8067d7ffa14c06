"""A whole room whose four walls differ, and stations around it with overlapping views.

Furniture of a room: boxes, a cupboard against a wall, a sphere, and optionally a box in the corner.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calib.numerics import Floats
from hw.errors import DeviceError
from hw.settings import SimulatedRigSettings
from hw.simulated.device import PlacedDevice
from hw.simulated.placement import SHORT_THROW, RigGeometry, draw_rig, lit_and_visible, look_at, seen
from hw.simulated.scene import Scene
from hw.simulated.shapes import Ball, Block

# Furniture overlaps the floor, the wall or the box below by this much, so that no light passes through a gap.
EMBEDDED_M = 0.004
_STREAM = 200  # stream of random numbers; a single corner uses others
_OUTSIDE_M = 0.03  # linings extend this far beyond the room, so that no light passes through a gap
_FARTHER_M = 15.0  # additional extent per radian of `walls_off_deg`: three standard deviations along 5 m
_LINING_M = 0.12
_CLEARANCE_M = 0.25  # around each device
_OVERLAP = 0.3  # smallest share of a station's view that its neighbour sees too
_LIT = 0.25  # smallest share of a station's pixels that are directly lit
_ON_SPHERE = 3  # smallest number of rays of the coarse grid on each sphere
_FULL_CIRCLE = 6  # stations of a full circle; fewer form an open chain
_ATTEMPTS = 60
_ROUNDS = 60
_UP = np.array([0.0, 0.0, 1.0])

Station = tuple[PlacedDevice, PlacedDevice]


def draw_furniture(rng: np.random.Generator, sphere_radius_m: float, askew: float) -> tuple[tuple[Block, ...], Ball]:
    """Three cardboard boxes with any heading, two of them stacked; a cupboard; a sphere on the floor.

    `askew`: the angle in radians between the cupboard and its wall.
    """
    large = _standing(rng, rng.uniform((0.25, 0.25, 0.15), (0.45, 0.4, 0.4)), _place(rng, 0.45, 1.1))
    stacked = _on_top(rng, large, rng.uniform((0.12, 0.12, 0.08), (0.2, 0.2, 0.2)))
    second = _standing(rng, rng.uniform((0.15, 0.15, 0.1), (0.35, 0.35, 0.5)), _place(rng, 0.35, 1.2))
    cupboard = _against_wall(rng, rng.uniform((0.6, 0.3, 0.7), (1.2, 0.45, 1.9)), rng.uniform(0.7, 1.4), askew)
    x, y = _place(rng, 0.3, 0.9)
    sphere = Ball(np.array([x, y, sphere_radius_m]), sphere_radius_m)
    return (large, stacked, second, cupboard), sphere


def draw_second_sphere(rng: np.random.Generator, sphere: Ball, length_m: float) -> Ball:
    """The second sphere of a ball bar. `length_m` is between centres; the bar is level or raised, in any direction."""
    azimuth, height = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.8)
    level = np.sqrt(1 - height**2)
    direction = np.array([level * np.cos(azimuth), level * np.sin(azimuth), height])
    return Ball(sphere.centre + length_m * direction, sphere.radius)


def draw_corner_box(rng: np.random.Generator) -> Block:
    """A box pushed into the corner, almost square to the walls."""
    size = rng.uniform((0.15, 0.15, 0.15), (0.3, 0.3, 0.3))
    heading = rng.uniform(-0.15, 0.15)
    reach = 0.5 * (abs(np.cos(heading)) + abs(np.sin(heading))) * size[:2].max()
    return box(size, reach + rng.uniform(0.005, 0.03, 2), heading)


def overlap(first: Block | Ball, second: Block | Ball) -> bool:
    """Whether two solids intersect, tested at the points of a lattice in either."""
    return bool(first.contains(_lattice(second)).any() or second.contains(_lattice(first)).any())


def _place(rng: np.random.Generator, low: float, high: float) -> Floats:
    return rng.uniform(low, high, 2)


def _standing(rng: np.random.Generator, size: Floats, place: Floats) -> Block:
    return box(size, place, rng.uniform(0, np.pi))


def _on_top(rng: np.random.Generator, below: Block, size: Floats) -> Block:
    top = below.origin + below.edges.sum(axis=0)
    middle = below.origin + 0.5 * below.edges.sum(axis=0)
    return box(size, middle[:2] + rng.uniform(-0.05, 0.05, 2), rng.uniform(0, np.pi), float(top[2]))


def _against_wall(rng: np.random.Generator, size: Floats, start: float, askew: float) -> Block:
    """A cupboard that touches one of the two walls with its back or an edge, `start` metres from the corner."""
    width, depth, height = size
    away = (width * abs(np.sin(askew)) + depth * np.cos(askew)) / 2 - EMBEDDED_M
    if rng.random() < 0.5:
        return box(np.array([width, depth, height]), np.array([start + width / 2, away]), askew)
    return box(np.array([depth, width, height]), np.array([away, start + width / 2]), askew)


def box(size: Floats, place: Floats, heading: float, floor: float = 0.0) -> Block:
    """A box of `size` (along, across, up) whose base is centred at `place` (2,), rotated by `heading` radians."""
    cosine, sine = np.cos(heading), np.sin(heading)
    turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    edges = turned * (size + np.array([0.0, 0.0, EMBEDDED_M]))[:, None]
    origin = np.array([*place, floor - EMBEDDED_M]) - 0.5 * (edges[0] + edges[1])
    return Block(origin, edges)


def _lattice(solid: Block | Ball) -> Floats:
    steps = np.linspace(0.0, 1.0, 9)
    unit = np.stack(np.meshgrid(steps, steps, steps)).reshape(3, -1)
    if isinstance(solid, Block):
        return solid.origin[:, None] + solid.edges.T @ unit
    cube = 2 * unit - 1
    ball: Floats = cube / np.maximum(np.linalg.norm(cube, axis=0), 1.0)
    return solid.centre[:, None] + solid.radius * ball


@dataclass(frozen=True)
class WholeRoom:
    """The scene, and the rig's camera and projector at each station, in order around the room."""

    scene: Scene
    stations: tuple[Station, ...]


def draw_whole_room(settings: SimulatedRigSettings, walls: Block) -> WholeRoom:
    """Draw a furnished room inside `walls` and its stations, with a short-throw projector.

    Raises DeviceError if the seed has no such room.
    """
    fittings_rng, rng, rig_rng = (np.random.default_rng([settings.seed, _STREAM, stream]) for stream in range(3))
    fittings = _fittings(fittings_rng, walls, np.radians(settings.walls_off_deg))
    rig = draw_rig(rig_rng, settings.distortion, SHORT_THROW)
    for _ in range(_ROUNDS):
        scene = _furnish(rng, Scene(walls, fittings, all_round=True), settings)
        stations = _draw_stations(rng, scene, rig, settings.stations) if scene else None
        if scene and stations and _spheres_are_seen(scene, stations):
            return WholeRoom(scene, stations)
    raise DeviceError(
        f"the simulated rig finds no {settings.stations} places round its room whose views overlap; use another seed "
        f"than {settings.seed}, or another number of stations"
    )


def _fittings(rng: np.random.Generator, walls: Block, off: float) -> tuple[Block, ...]:
    """Linings that make opposite walls non-parallel, one of them with a door recess; and a chimney breast."""
    far_x, far_y, height = walls.lengths
    left, width, top = rng.uniform((0.35 * far_y, 0.8, 1.95), (0.6 * far_y, 0.95, 2.1))
    beyond = _OUTSIDE_M + _FARTHER_M * off
    low, high = -beyond, height + beyond
    tilts = off * rng.standard_normal((2, 2))
    door_wall, other_wall = (_inner_frame(walls, axis, tilt) for axis, tilt in zip((0, 1), tilts, strict=True))
    across, deep, place = rng.uniform((0.5, 0.2, 0.3), (0.8, 0.3, 0.6))
    chimney = box(
        np.array([across, deep + _LINING_M, high - low]),
        np.array([far_x * place, far_y - (deep + _LINING_M) / 2]),
        0.0,
        low,
    )
    return (
        _lining(door_wall, (-beyond, left), (low, high)),
        _lining(door_wall, (left + width, far_y + beyond), (low, high)),
        _lining(door_wall, (left, left + width), (top, high)),
        _lining(other_wall, (-far_x - beyond, beyond), (low, high)),
        chimney,
    )


def _inner_frame(walls: Block, axis: int, tilt: Floats) -> tuple[Floats, Floats]:
    """Start of a lining in front of the wall opposite along `axis`, and its directions (rows): outward, across, up."""
    outward = walls.edges[axis] / walls.lengths[axis] + tilt[0] * walls.edges[1 - axis] / walls.lengths[1 - axis]
    outward = outward + tilt[1] * _UP
    outward /= np.linalg.norm(outward)
    across = np.cross(_UP, outward)
    across /= np.linalg.norm(across)
    start = walls.origin + walls.edges[axis] - _LINING_M * outward
    return start, np.stack([outward, across, np.cross(outward, across)])


def _lining(frame: tuple[Floats, Floats], across: tuple[float, float], up: tuple[float, float]) -> Block:
    start, (outward, sideways, upward) = frame
    edges = np.stack([2 * _LINING_M * outward, (across[1] - across[0]) * sideways, (up[1] - up[0]) * upward])
    return Block(start + across[0] * sideways + up[0] * upward, edges)


def _furnish(rng: np.random.Generator, bare: Scene, settings: SimulatedRigSettings) -> Scene | None:
    """The room with furniture along all walls, boxes in front of it, one or two spheres; None if they overlap."""
    if not settings.furniture:
        return bare
    askew = np.radians(settings.furniture_askew_deg)
    pieces = [*_along_the_walls(rng, bare.room, askew), *_boxes(rng, bare.room)]
    sphere = Ball(
        np.array([*_position_in_front_of_furniture(rng, bare.room), settings.sphere_radius_m]), settings.sphere_radius_m
    )
    second = None if settings.ball_bar_m is None else draw_second_sphere(rng, sphere, settings.ball_bar_m)
    spheres = [sphere] if second is None else [sphere, second]
    solids: list[Block | Ball] = [*pieces, *spheres]
    blocked = any(overlap(first, second) for first, second in combinations(solids, 2))
    outside = not all(_surrounded_by_air(bare, ball) for ball in spheres[1:])
    if blocked or outside:
        return None
    return replace(bare, blocks=(*bare.blocks, *pieces), sphere=sphere, second_sphere=second)


def _along_the_walls(rng: np.random.Generator, room: Block, askew: float) -> Iterator[Block]:
    """A large and a small piece at each wall, each rotated from it by a normal deviate times `askew` radians."""
    far_x, far_y = room.lengths[:2] - _LINING_M
    for wall, length in ((0, far_y), (1, far_x), (2, far_y), (3, far_x)):
        shares = rng.permutation([0.28, 0.72]) + rng.uniform(-0.08, 0.08, 2)
        sizes = rng.uniform(((0.6, 0.3, 0.7), (0.3, 0.25, 0.3)), ((1.2, 0.45, 1.9), (0.6, 0.4, 0.9)))
        for share, (width, depth, height) in zip(shares, sizes, strict=True):
            turn = askew * rng.standard_normal()
            away = (width * abs(np.sin(turn)) + depth * np.cos(turn)) / 2 - EMBEDDED_M
            place = [(away, share * length), (share * length, away)][wall % 2]
            if wall >= 2:
                place = [(far_x - away, share * length), (share * length, far_y - away)][wall % 2]
            heading = turn + (np.pi / 2 if wall % 2 == 0 else 0.0)
            yield box(np.array([width, depth, height]), np.array(place), heading)


def _boxes(rng: np.random.Generator, room: Block) -> Iterator[Block]:
    for _ in range(3):
        size = rng.uniform((0.2, 0.2, 0.15), (0.45, 0.4, 0.5))
        yield box(size, _position_in_front_of_furniture(rng, room), rng.uniform(0, np.pi))


def _position_in_front_of_furniture(rng: np.random.Generator, room: Block) -> Floats:
    """A position (2,) on the floor, in front of the furniture at the walls and away from the middle."""
    share = rng.uniform(0.2, 0.8, 2)
    edge = rng.integers(2)
    share[edge] = rng.choice([rng.uniform(0.2, 0.28), rng.uniform(0.72, 0.8)])
    return share * room.lengths[:2]


def _surrounded_by_air(scene: Scene, sphere: Ball) -> bool:
    reach = sphere.radius * np.concatenate([np.eye(3), -np.eye(3)])
    return bool(scene.is_free((sphere.centre + reach).T).all())


def _draw_stations(rng: np.random.Generator, scene: Scene, rig: RigGeometry, count: int) -> tuple[Station, ...] | None:
    """Stations in evenly spaced directions; None if not each sees enough of what the one before sees."""
    stations: list[Station] = []
    for number in range(count):
        for _ in range(_ATTEMPTS):
            station = rig.placed(*_camera_pose(rng, scene.room, number / max(count, _FULL_CIRCLE)))
            neighbours = [stations[-1]] if stations else []
            neighbours += stations[:1] if number == count - 1 >= _FULL_CIRCLE - 1 else []
            if _is_good(scene, station, neighbours):
                stations.append(station)
                break
        else:
            return None
    return tuple(stations)


def _camera_pose(rng: np.random.Generator, room: Block, turn: float) -> tuple[Floats, Floats]:
    """Rotation from the world and centre of a camera that looks across the middle of the room, slightly downwards.

    `turn`: share of a full turn from the direction of the first station, which faces the corner at the origin.
    """
    middle = room.origin + room.edges.sum(axis=0) / 2
    azimuth = np.arctan2(-middle[1], -middle[0]) + 2 * np.pi * turn + np.radians(rng.uniform(-7, 7))
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    back = rng.uniform(0.3, 0.55) * room.lengths[:2] / 2
    centre = middle - ahead * [*back, 0.0] + [*rng.uniform(-0.1, 0.1, 2), 0.0]
    centre[2] = rng.uniform(1.25, 1.65)
    down = np.tan(np.radians(rng.uniform(10, 22)))
    return look_at(centre, centre + ahead - down * _UP, _UP, rng.uniform(-6, 6)), centre


def _is_good(scene: Scene, station: Station, neighbours: list[Station]) -> bool:
    """Whether the rig has clearance, lights enough of its view, and sees enough of what its neighbours see."""
    offsets = _CLEARANCE_M * np.concatenate([np.eye(3), -np.eye(3)]).T
    if not all(scene.is_free(device.centre[:, None] + offsets).all() for device in station):
        return False
    points, surface, lit = seen(scene, *station)
    if lit.mean() < _LIT:
        return False
    points, surface = points[:, lit], surface[lit]
    return all(lit_and_visible(scene, *neighbour, surface, points).mean() >= _OVERLAP for neighbour in neighbours)


def _spheres_are_seen(scene: Scene, stations: tuple[Station, ...]) -> bool:
    """Whether at least one station sees each sphere."""
    met = np.concatenate([surface[lit] for _, surface, lit in (seen(scene, *station) for station in stations)])
    return all(np.count_nonzero(met == number) >= _ON_SPHERE for number in scene.spheres)
