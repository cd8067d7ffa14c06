"""Synthetic whole rooms with ground truth: a rig's organised clouds from several places, and matches of each pair of
several cameras and projectors, all facing one corner.

World: x and y along the walls, z up, lengths in metres; the floor is at z = 0.

As in `calib.synthetic.rooms`, the projector's rays are intersected with walls and boxes, visible points are projected
into the camera, and noise is added to the projector's pixels.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.geometry import Intrinsics, Matches, Pose
from calib.numerics import Bools, Floats, Image, Ints
from calib.synthetic.captures import inside, jittered_grid, look_at
from calib.synthetic.rooms import (
    RoomOptions,
    SyntheticScene,
    box_on,
    cast,
    first_hits,
    is_free,
    on_waves,
    random_box,
    random_walls,
    random_waves,
)

_UP = np.array([0.0, 0.0, 1.0])
_POSTER_M, _PRINTED_M = 0.6, (0.23, 0.11, 0.07)
_OFF_THE_WALLS = np.array([0.37, 0.41, 0.43])
_TABLE, _PRIMES = 65_521, np.array([7919, 104_729, 1_299_709])
STATION_CAMERA = Intrinsics(612, 512, (450.0, 450.0), (309.0, 251.0), (-0.06, 0.01, 0.0, 0.0, 0.0))
_CORNER = (0, 2, 4)  # the floor, and the walls at x = 0 and y = 0
_APART_M = 0.5
_ATTEMPTS = 500


class FurnishedRoom(NamedTuple):
    """Six walls and furniture, and the sides (3,) of the room."""

    scene: SyntheticScene
    size: Floats


@dataclass(frozen=True)
class StationCloud:
    """`points` (H, W, 3) in the camera's frame, as measured, NaN for none; `place`: X_world = R X + t.

    `picture` (H, W): the lit scene; None for a room without paint.
    """

    points: NDArray[np.float32]
    place: Pose
    picture: Image | None = None


@dataclass(frozen=True, eq=False)
class Paint:
    """Plain surfaces with posters here and there: steps of brightness in `posters` of the volume's cubes of 0.6 m.

    It is a function of position, so that all stations see the same.
    """

    seed: int
    posters: float = 0.12

    def albedo(self, points: Floats) -> Floats:
        """The albedo (N,) of points (N, 3) in metres."""
        drawn = self._drawn(points, _POSTER_M, 0) < self.posters
        fine = np.mean([self._drawn(points, size, 1 + k) for k, size in enumerate(_PRINTED_M)], axis=0)
        return np.where(drawn, fine, 0.6)

    def _drawn(self, points: Floats, cell: float, layer: int) -> Floats:
        """A random number (N,) for the cube that each point is in, its corners away from the walls' planes."""
        cube = np.floor(points / cell + _OFF_THE_WALLS).astype(np.int64) + 64
        table = np.random.default_rng([self.seed, layer]).random(_TABLE)
        values: Floats = table[(cube @ _PRIMES) % _TABLE]
        return values


@dataclass(frozen=True)
class CloudErrors:
    """Errors of a measured cloud. `noise_m`: along the ray at 3 m, growing with the distance squared; `shape`: relative
    deformation by a wrong calibration, the same for all stations; `steepest_deg`: surfaces at a steeper slant are not
    seen.
    """

    noise_m: float = 0.003
    shape: float = 0.003
    steepest_deg: float = 82.0


def random_furnished_room(
    rng: np.random.Generator,
    pieces: int = 8,
    walls_off_deg: float = 0.3,
    size: tuple[float, float, float] | None = None,
) -> FurnishedRoom:
    """A random room with `pieces` of furniture along the walls, and walls that are a little off square."""
    sides = np.array(size or (rng.uniform(3.8, 5.2), rng.uniform(3.2, 4.4), rng.uniform(2.4, 2.9)))
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    normals += np.radians(walls_off_deg) * rng.normal(size=(6, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    on = np.concatenate([np.tile(sides / 2, (3, 1)) * (1 - np.eye(3)), np.tile(sides / 2, (3, 1)) * (1 + np.eye(3))])
    solids = [(normals, np.sum(normals * on, axis=1)), *(_piece(rng, sides) for _ in range(pieces))]
    return FurnishedRoom(SyntheticScene(solids, np.zeros((0, 4)), np.zeros((6, 1, 5))), sides)


def _piece(rng: np.random.Generator, room: Floats) -> tuple[Floats, Floats]:
    size = np.array([rng.uniform(0.4, 1.3), rng.uniform(0.3, 0.7), rng.uniform(0.35, 1.9)])
    wall = rng.integers(4)
    yaw = np.pi / 2 * wall + np.radians(rng.normal(0, 4))
    across, along = (room[1], room[0]) if wall % 2 == 0 else (room[0], room[1])
    out = across / 2 - size[1] / 2 - rng.uniform(0.03, 0.25)
    aside = rng.uniform(-0.5, 0.5) * max(along - size[0], 0.1)
    turned = Rotation.from_euler("z", np.pi / 2 * wall).as_matrix() @ np.array([aside, -out, 0.0])
    return box_on(turned + np.array([room[0], room[1], size[2]]) / 2, size / 2, yaw)


def ring(rng: np.random.Generator, room: FurnishedRoom, stations: int, step_deg: float = 60.0) -> list[Pose]:
    """Places of a rig that is carried around once. Each looks across the room, and overlaps with the next."""
    start, places = rng.uniform(0, 2 * np.pi), []
    middle = room.size / 2
    for k in range(stations):
        for _ in range(100):
            yaw = start + np.radians(step_deg * (k + rng.uniform(-0.08, 0.08)))
            ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
            back = rng.uniform(0.5, 0.75) * min(room.size[:2]) / 2
            eye = middle * [1, 1, 0] - back * ahead + [*rng.uniform(-0.15, 0.15, 2), rng.uniform(1.2, 1.6)]
            if not any(np.all(outwards @ eye < reach + 0.35) for outwards, reach in room.scene.solids[1:]):
                break
        target = eye + ahead + [0, 0, -rng.uniform(0.15, 0.35)]
        rotation = look_at(eye, target, _UP, rng.normal(0, 0.03)).T
        places.append(Pose(rotation, eye))
    return places


def seen_from(
    room: FurnishedRoom,
    place: Pose,
    rng: np.random.Generator,
    errors: CloudErrors | None = None,
    camera: Intrinsics = STATION_CAMERA,
    paint: Paint | None = None,
) -> StationCloud:
    """The cloud of one station and, with `paint`, its picture. The projector is 0.3 m beside the camera; points in its
    shadow are missing.
    """
    errors = errors or CloudErrors()
    rays = camera.unproject(camera.size.pixels.reshape(-1, 2))
    directions = place.rotate(rays)
    depth, _ = first_hits(directions, place.translation, room.scene)
    hit = place.translation + depth[:, None] * directions
    projector = place @ np.array([0.3, 0.05, 0.0])
    lit = first_hits(hit - projector, projector, room.scene)[0] > 1 - 1e-3
    points = rays * depth[:, None]
    points[~lit | _steep(points, camera, errors)] = np.nan
    z = points[:, 2:]
    bent = 1 + errors.shape * ((z / 3.0 - 1) + 0.7 * points[:, :1] / z - 0.5 * (points[:, 1:2] / z) ** 2)
    along = 1 + errors.noise_m / 9.0 * z * rng.normal(size=z.shape)
    cloud = (points * bent * along).reshape(camera.height, camera.width, 3).astype(np.float32)
    if paint is None:
        return StationCloud(cloud, place)
    light = np.where(lit, paint.albedo(hit) / np.sum((hit - projector) ** 2, axis=1), 0.0)
    light = np.minimum(light / np.percentile(light, 98), 1.0) + 0.01 * rng.normal(size=len(light))
    picture = np.rint(255 * np.clip(light, 0.0, 1.0)).astype(np.uint8).reshape(camera.height, camera.width)
    return StationCloud(cloud, place, picture)


def moved_rig(station: StationCloud, stretch: float = 0.08) -> StationCloud:
    """The same station measured with changed extrinsics and the old calibration."""
    z = station.points[..., 2:]
    scale = 1 + stretch * (z / 3.0) + 0.5 * stretch * station.points[..., :1] / z
    return replace(station, points=(station.points * scale).astype(np.float32))


def _steep(points: Floats, camera: Intrinsics, errors: CloudErrors) -> Bools:
    """Which points (N, 3) of an image lie on a surface at too steep a slant, or at its edge."""
    grid = points.reshape(camera.height, camera.width, 3)
    across, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    normal = np.cross(across, down).reshape(-1, 3)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = (
            np.abs(np.sum(normal * points, axis=1)) / np.linalg.norm(normal, axis=1) / np.linalg.norm(points, axis=1)
        )
    steep: Bools = ~(cosine > np.cos(np.radians(errors.steepest_deg)))
    return steep


@dataclass(frozen=True, eq=False)
class SyntheticNetwork:
    """`captures`: matches of each (camera, projector), labelled 0, 1, 2 on the corner's faces, 3 and up on others.

    `devices`, `poses`: ground truth by name, X_room = rotation X_device + translation, in metres. `scene`: the room.
    """

    captures: Mapping[tuple[str, str], Matches]
    devices: Mapping[str, Intrinsics]
    poses: Mapping[str, Pose]
    scene: SyntheticScene

    @property
    def planes(self) -> tuple[Floats, Floats]:
        """Normals (P, 3) and offsets (P,) of the planes, by label: normal · X = offset."""
        normals, offsets = (np.concatenate(parts) for parts in zip(*self.scene.solids, strict=True))
        order = _by_label(len(offsets))
        return normals[order], offsets[order]


def random_network(
    rng: np.random.Generator, cameras: int, projectors: int, options: RoomOptions | None = None
) -> SyntheticNetwork:
    """Devices `camera1`, …, `projector1`, … Raises ValueError if no room is found where all see the corner."""
    options = options or RoomOptions(boxes=2, count=40_000)
    names = [*(f"camera{i + 1}" for i in range(cameras)), *(f"projector{i + 1}" for i in range(projectors))]
    for _ in range(_ATTEMPTS):
        solids = [random_walls(rng, options), *(random_box(rng, options) for _ in range(options.boxes))]
        waves = random_waves(rng, options) if options.wavy else np.zeros((6, 1, 5))
        scene = SyntheticScene(solids, np.zeros((0, 4)), waves)
        devices = {
            name: _varied(rng, options.camera if i < cameras else options.projector) for i, name in enumerate(names)
        }
        poses = _poses(rng, names, scene, options)
        captures = {
            (camera, projector): _seen(rng, options, scene, (devices[camera], devices[projector]), poses[camera], at)
            for camera in names[:cameras]
            for projector in names[cameras:]
            for at in (poses[projector],)
        }
        least = options.least_share * options.count
        if all(matches.on_each_face.min() > 5 * least for matches in captures.values()):
            return SyntheticNetwork(captures, devices, poses, scene)
    raise ValueError("no room in which every pair sees the corner")


def with_turned_camera(network: SyntheticNetwork, pair: tuple[str, str], turn: Floats) -> SyntheticNetwork:
    """The camera of a pair was turned before that capture was taken, by a rotation vector (3,) in radians, in its own
    frame.
    """
    camera, matches = network.devices[pair[0]], network.captures[pair]
    pixels = camera.project(Rotation.from_rotvec(turn).apply(camera.unproject(matches.camera_px)))
    turned = replace(matches, camera_px=pixels)[inside(pixels, camera)]
    return replace(network, captures={**network.captures, pair: turned})


def _varied(rng: np.random.Generator, device: Intrinsics) -> Intrinsics:
    focal = device.focal_px[0] * float(np.exp(rng.normal(0, 0.1)))
    x, y = (float(value) for value in np.array(device.principal_point_px) + rng.normal(0, 15, 2))
    k1, k2, p1, p2, k3 = device.distortion
    return replace(
        device,
        focal_px=(focal, focal),
        principal_point_px=(x, y),
        distortion=(k1 + float(rng.normal(0, 0.02)), k2, p1, p2, k3),
    )


def _poses(rng: np.random.Generator, names: list[str], scene: SyntheticScene, options: RoomOptions) -> dict[str, Pose]:
    poses: dict[str, Pose] = {}
    for name in names:
        while name not in poses:
            eye = np.array(options.size) * rng.uniform((0.4, 0.4, 0.35), (0.9, 0.9, 0.85))
            near = any(np.linalg.norm(eye - pose.translation) < _APART_M for pose in poses.values())
            if near or not is_free(eye, scene):
                continue
            rotation = look_at(eye, rng.uniform(0.1, 0.6, 3), _UP, rng.normal(0, 0.05))
            poses[name] = Pose(rotation.T, eye)
    return poses


def _seen(
    rng: np.random.Generator,
    options: RoomOptions,
    scene: SyntheticScene,
    pair: tuple[Intrinsics, Intrinsics],
    camera_at: Pose,
    projector_at: Pose,
) -> Matches:
    camera, projector = pair
    pixels = jittered_grid(rng, projector, options.count)
    rays = projector_at.rotate(projector.unproject(pixels))
    points, plane = cast(rays, projector_at.translation, scene)
    points = on_waves(points, plane, rays, scene.solids[0][0], scene.waves)
    camera_px = camera.project(camera_at.undo(points))
    visible = inside(camera_px, camera)
    visible[visible] = cast(points[visible] - camera_at.translation, camera_at.translation, scene)[1] == plane[visible]
    label = np.argsort(_by_label(6 * len(scene.solids)))[plane[visible]].astype(np.int32)
    noisy = pixels[visible] + rng.normal(0, options.noise_px, (len(label), 2))
    return Matches(camera_px[visible], noisy, label)


def _by_label(count: int) -> Ints:
    """The number in the scene of each label's plane."""
    return np.array([*_CORNER, *(i for i in range(count) if i not in _CORNER)])
