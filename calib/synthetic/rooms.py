"""Synthetic stations in a furnished room: matches projected from points in space, labelled with their planes.

No code is shared with the solver. The projector's rays are intersected with walls and boxes, visible points are
projected into the camera, and noise is added to the projector's pixels.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry import Calibration, Intrinsics, Matches, Pose
from calib.numerics import Bools, Floats, Ints
from calib.synthetic.captures import inside, jittered_grid, look_at

_CAMERA = Intrinsics(1224, 1024, (1000.0, 1000.0), (628.0, 527.0), (-0.08, 0.02, 0.0, 0.0, 0.0))
_PROJECTOR = Intrinsics(1280, 800, (1150.0, 1150.0), (650.0, 420.0), (-0.03, 0.0, 0.0, 0.0, 0.0))
_ATTEMPTS = 500
_WALLS = 6
_CLEAR, _SHADOW = 0.1, 1e-6
_WAVES, _WAVELENGTHS = 4, (1.5, 4.0)


@dataclass(frozen=True)
class RoomOptions:
    """Parameters: lengths in metres, angles in degrees, noise as a standard deviation of each coordinate.

    `size`: of the room, x, y, z; each of its six planes is rotated by a normal angle of `walls_off_deg` about both
    directions in it, and has waves of 1.5 to 4 m with a standard deviation of `wavy`. `boxes`: pieces of furniture on
    the floor; `balls`: in the air, their matches have no label. `stations` form a ring and face across the room;
    `count`: number of sampled projector pixels. A plane is labelled if it has `least_share` of them.
    """

    camera: Intrinsics = _CAMERA
    projector: Intrinsics = _PROJECTOR
    size: tuple[float, float, float] = (4.5, 3.6, 2.6)
    walls_off_deg: float = 0.3
    boxes: int = 6
    balls: int = 0
    stations: int = 6
    baseline: float = 0.35
    count: int = 100_000
    noise_px: float = 0.05
    least_share: float = 0.004
    wavy: float = 0.0


class SyntheticScene(NamedTuple):
    """`solids`: normals and offsets of the room, then of the boxes. `balls` (B, 4): centres and radii."""

    solids: list[tuple[Floats, Floats]]
    balls: Floats
    waves: Floats


@dataclass(frozen=True, eq=False)
class SyntheticStation:
    """A camera's view of a room."""

    matches: Matches
    """Labels are planes of the room, −1 on those with too few."""
    pose: Pose
    """X_room = R X_camera + t."""


@dataclass(frozen=True, eq=False)
class SyntheticRoom:
    """Stations with their ground truth, in metres.

    Planes normal · X = offset, `normals` (P, 3) into the room: floor, ceiling, four walls, then those of the boxes.
    """

    stations: tuple[SyntheticStation, ...]
    calibration: Calibration
    normals: Floats
    offsets: Floats


def random_room(rng: np.random.Generator, options: RoomOptions | None = None, **changes: Any) -> SyntheticRoom:
    """A rig in a random room in which each station sees three planes or more. Raises ValueError if none is found."""
    options = replace(options or RoomOptions(), **changes)
    rig = _random_rig(rng, options)
    for _ in range(_ATTEMPTS):
        solids = [random_walls(rng, options), *(random_box(rng, options) for _ in range(options.boxes))]
        scene = SyntheticScene(solids, _random_balls(rng, options), random_waves(rng, options))
        stations = [_station(rng, options, rig, scene, k) for k in range(options.stations)]
        if all(station is not None for station in stations):
            normals, offsets = (np.concatenate(parts) for parts in zip(*solids, strict=True))
            return SyntheticRoom(tuple(station for station in stations if station is not None), rig, normals, offsets)
    raise ValueError("no room in which every station sees three planes")


def _random_rig(rng: np.random.Generator, options: RoomOptions) -> Calibration:
    eye = options.baseline * np.array([rng.choice([-1, 1]), rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2)])
    target = np.array([0.0, 0.0, rng.uniform(2.5, 3.5)])
    rotation = look_at(eye, target, np.array([0.0, -1.0, 0.0]), rng.normal(0, np.radians(2)))
    return Calibration(options.camera, options.projector, Pose(rotation, -rotation @ eye), unit="m")


def random_walls(rng: np.random.Generator, options: RoomOptions) -> tuple[Floats, Floats]:
    """Normals (6, 3) into the room and offsets (6,). Apart from the angles, the room's lower corner is the origin."""
    x, y, z = options.size
    normals = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], float)
    feet = np.array([[x / 2, y / 2, 0], [x / 2, y / 2, z], [0, y / 2, z / 2], [x, y / 2, z / 2]])
    feet = np.concatenate([feet, [[x / 2, 0, z / 2], [x / 2, y, z / 2]]])
    turned = normals + np.radians(options.walls_off_deg) * rng.normal(size=normals.shape) * (normals == 0)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    return turned, np.sum(turned * feet, axis=1)


def random_box(rng: np.random.Generator, options: RoomOptions) -> tuple[Floats, Floats]:
    """Normals (6, 3) out of a box near a wall and offsets (6,); the last is its bottom, below the floor."""
    half = np.array([*rng.uniform(0.2, 0.6, 2), rng.choice([0.22, 0.38, 0.5, 0.95])])
    place = rng.uniform(0.1, 0.9, 2) * options.size[:2]
    axis = rng.integers(2)
    place[axis] = rng.choice([0.0, options.size[axis]])
    normals, offsets = box_on(np.array([*place, half[2]]), half, np.radians(rng.normal(0, 10)))
    offsets[5] += 0.1
    return normals, offsets


def box_on(centre: Floats, half: Floats, yaw: float) -> tuple[Floats, Floats]:
    """Normals (6, 3) out of a box, and offsets (6,); `half` (3,) its sides, rotated by `yaw` about the vertical."""
    axes = Rotation.from_euler("z", yaw).as_matrix().T
    normals = np.concatenate([axes, -axes])
    return normals, normals @ centre + np.tile(half, 2)


def _station(
    rng: np.random.Generator,
    options: RoomOptions,
    rig: Calibration,
    scene: SyntheticScene,
    number: int,
) -> SyntheticStation | None:
    width, depth, _ = options.size
    around = 2 * np.pi * number / options.stations + rng.normal(0, 0.1)
    across = np.array([np.cos(around), np.sin(around)])
    centre = np.array([width, depth]) / 2
    eye = np.array([*(centre - 0.26 * across * [width, depth] + rng.normal(0, 0.1, 2)), rng.uniform(1.1, 1.8)])
    target = np.array([*(centre + 0.4 * across * [width, depth] + rng.normal(0, 0.2, 2)), rng.uniform(0.4, 1.3)])
    pose = Pose(look_at(eye, target, np.array([0.0, 0.0, 1.0]), rng.normal(0, 0.05)).T, eye)
    projector_eye = pose @ rig.projector_centre
    if not (is_free(eye, scene) and is_free(projector_eye, scene)):
        return None
    pixels = jittered_grid(rng, rig.projector, options.count)
    rays = (pose @ rig.pose.inverse()).rotate(rig.projector.unproject(pixels))
    points, plane = cast(rays, projector_eye, scene)
    points = on_waves(points, plane, rays, scene.solids[0][0], scene.waves)
    camera_px = rig.camera.project(pose.undo(points))
    visible = inside(camera_px, rig.camera)
    there, again = cast(points[visible] - eye, eye, scene)
    on_ball = again >= _WALLS * len(scene.solids)
    visible[visible] = (again == plane[visible]) & ~(
        on_ball & (np.linalg.norm(there - points[visible], axis=1) > _SHADOW)
    )
    plane = plane[visible]
    enough = np.bincount(plane, minlength=_WALLS * len(scene.solids)) >= options.least_share * options.count
    enough[_WALLS * len(scene.solids) :] = False
    if np.count_nonzero(enough) < 3:
        return None
    label = np.where(enough[plane], plane, -1).astype(np.int32)
    noisy = pixels[visible] + rng.normal(0, options.noise_px, (len(plane), 2))
    return SyntheticStation(Matches(camera_px[visible], noisy, label), pose)


def random_waves(rng: np.random.Generator, options: RoomOptions) -> Floats:
    """Waves of the six planes (6, waves, 5): wave vector (3) in radians per metre, phase and amplitude."""
    waves = np.empty((_WALLS, _WAVES, 5))
    directions = rng.normal(size=(_WALLS, _WAVES, 3))
    lengths = rng.uniform(*_WAVELENGTHS, (_WALLS, _WAVES, 1))
    waves[..., :3] = 2 * np.pi / lengths * directions / np.linalg.norm(directions, axis=2, keepdims=True)
    waves[..., 3] = rng.uniform(0, 2 * np.pi, (_WALLS, _WAVES))
    waves[..., 4] = options.wavy * np.sqrt(2 / _WAVES)
    return waves


def on_waves(points: Floats, plane: Ints, rays: Floats, normals: Floats, waves: Floats) -> Floats:
    """Points (N, 3) moved along their rays (N, 3) onto the wavy walls."""
    moved = points.copy()
    for wall in np.flatnonzero(waves[:, :, 4].any(axis=1)):
        on = plane == wall
        phases = points[on] @ waves[wall, :, :3].T + waves[wall, :, 3]
        heights = np.sin(phases) @ waves[wall, :, 4]
        moved[on] += rays[on] * (heights / (rays[on] @ normals[wall]))[:, None]
    return moved


def _random_balls(rng: np.random.Generator, options: RoomOptions) -> Floats:
    centres = np.array(options.size) * rng.uniform((0.15, 0.15, 0.1), (0.85, 0.85, 0.5), (options.balls, 3))
    return np.concatenate([centres, rng.uniform(0.08, 0.25, (options.balls, 1))], axis=1)


def is_free(point: Floats, scene: SyntheticScene) -> bool:
    """Whether a point is inside the room, and clear of boxes and balls."""
    (normals, offsets), *boxes = scene.solids
    return (
        bool(np.all(normals @ point > offsets + _CLEAR))
        and not any(np.all(outwards @ point < reach + _CLEAR) for outwards, reach in boxes)
        and bool(np.all(np.linalg.norm(point - scene.balls[:, :3], axis=1) > scene.balls[:, 3] + _CLEAR))
    )


def cast(directions: Floats, origin: Floats, scene: SyntheticScene) -> tuple[Floats, Ints]:
    """The first hits of rays (N, 3) from `origin`: points (N, 3) and plane numbers (N,), balls after the planes."""
    length, plane = first_hits(directions, origin, scene)
    return origin + length[:, None] * directions, plane.astype(np.int32)


def first_hits(directions: Floats, origin: Floats, scene: SyntheticScene) -> tuple[Floats, Ints]:
    """The same, as multiples (N,) of the directions."""
    (normals, offsets), *boxes = scene.solids
    length, plane = _first(directions, origin, normals, offsets, directions @ normals.T < 0)
    for i, (outwards, reach) in enumerate(boxes, start=1):
        facing = directions @ outwards.T
        entering, face = _last(directions, origin, outwards, reach, facing < 0)
        leaving, _ = _first(directions, origin, outwards, reach, facing > 0)
        hit = (entering > 0) & (entering < leaving) & (entering < length)
        length, plane = np.where(hit, entering, length), np.where(hit, _WALLS * i + face, plane)
    square = np.sum(directions**2, axis=1)
    for i, (*centre, radius) in enumerate(scene.balls, start=_WALLS * len(scene.solids)):
        along = directions @ (np.array(centre) - origin)
        inside_root = along**2 - square * (np.sum((np.array(centre) - origin) ** 2) - radius**2)
        entering = (along - np.sqrt(np.maximum(inside_root, 0.0))) / square
        hit = (inside_root > 0) & (entering > 0) & (entering < length)
        length, plane = np.where(hit, entering, length), np.where(hit, i, plane)
    return length, plane


def _first(directions: Floats, origin: Floats, normals: Floats, offsets: Floats, chosen: Bools) -> tuple[Floats, Ints]:
    lengths = np.where(chosen, _lengths(directions, origin, normals, offsets), np.inf)
    return lengths.min(axis=1), lengths.argmin(axis=1)


def _last(directions: Floats, origin: Floats, normals: Floats, offsets: Floats, chosen: Bools) -> tuple[Floats, Ints]:
    lengths = np.where(chosen, _lengths(directions, origin, normals, offsets), -np.inf)
    return lengths.max(axis=1), lengths.argmax(axis=1)


def _lengths(directions: Floats, origin: Floats, normals: Floats, offsets: Floats) -> Floats:
    with np.errstate(divide="ignore"):
        lengths: Floats = (offsets - normals @ origin) / (directions @ normals.T)
    return lengths
