"""Rooms with furniture, seen by a camera and lit by a projector: matches with true labels, by casting rays.

World: the walls are the planes x = 0, y = 0 and z = 0 (the floor), the room is the positive octant, lengths in metres.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.geometry.matches import Matches
from calib.numerics.array_types import Bools, Floats, Ints
from calib.synthetic.captures import look_at as rotation_to

SPHERE = 1000
OUTLIER = -1
_EPS = 1e-9


@dataclass(frozen=True)
class Box:
    """A box on the floor or above it: `centre` and `size` (3,), turned by `yaw` (radians) about the vertical."""

    centre: Floats
    size: Floats
    yaw: float = 0.0

    def hit(self, origin: Floats, directions: Floats) -> tuple[Floats, Ints, Floats]:
        """Where rays enter the box: distance (inf for a miss), face 0..5 (−x, +x, −y, …), and where they leave it."""
        turn = Rotation.from_euler("z", -self.yaw).as_matrix()
        o, d = turn @ (origin - self.centre), directions @ turn.T
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (-self.size / 2 - o) / d, (self.size / 2 - o) / d
        near, far = np.minimum(one, two), np.maximum(one, two)
        axis = np.argmax(near, axis=1)
        enter, leave = near.max(axis=1), far.min(axis=1)
        side = np.take_along_axis(d, axis[:, None], axis=1)[:, 0] < 0
        missed = ~((enter < leave) & (leave > 0))
        return np.where(missed, np.inf, enter), (2 * axis + side).astype(np.int32), np.where(missed, -np.inf, leave)


@dataclass(frozen=True)
class Room:
    """`walls`: whether the three walls are there (a box on a table has the floor only); `limit`: their extent (3,)."""

    boxes: tuple[Box, ...] = ()
    sphere: tuple[Floats, float] | None = None
    walls: tuple[bool, bool, bool] = (True, True, True)
    limit: Floats | None = None

    def cast(self, origin: Floats, directions: Floats) -> tuple[Floats, Ints]:
        """First surface met by each ray (N, 3): distance in units of the direction, surface id (−1: none).

        Ids: 0, 1, 2 walls; 3 + 6 b + face for box b; SPHERE.
        """
        limit = np.full(3, np.inf) if self.limit is None else self.limit
        depth, surface = np.full(len(directions), np.inf), np.full(len(directions), OUTLIER, np.int32)
        for wall in np.flatnonzero(self.walls):
            with np.errstate(divide="ignore", invalid="ignore"):
                t = -origin[wall] / directions[:, wall]
                point = origin + t[:, None] * directions
                closer = (t > _EPS) & (t < depth) & np.all((point > -1e-6) & (point < limit), axis=1)
            depth[closer], surface[closer] = t[closer], wall
        for b, box in enumerate(self.boxes):
            t, face, _ = box.hit(origin, directions)
            closer = (t > _EPS) & (t < depth)
            depth[closer], surface[closer] = t[closer], 3 + 6 * b + face[closer]
        if self.sphere is not None:
            t = _hit_sphere(*self.sphere, origin, directions)
            closer = (t > _EPS) & (t < depth)
            depth[closer], surface[closer] = t[closer], SPHERE
        return depth, surface

    def lit(self, points: Floats, source: Floats) -> Bools:
        """Whether nothing stands between points (N, 3) and the projector's centre."""
        depth, _ = self.cast(source, points - source)
        return depth > 1 - 1e-6


def _hit_sphere(centre: Floats, radius: float, origin: Floats, directions: Floats) -> Floats:
    a = np.sum(directions**2, axis=1)
    b = directions @ (origin - centre)
    c = float(np.sum((origin - centre) ** 2) - radius**2)
    with np.errstate(invalid="ignore"):
        t = (-b - np.sqrt(b * b - a * c)) / a
    return np.where(np.isfinite(t), t, np.inf)


@dataclass(frozen=True)
class Scene:
    """`surface` (N,): the true surface of each match, OUTLIER where the match is wrong."""

    matches: Matches
    surface: Ints
    room: Room
    calibration: Calibration


def paper_rig(camera_k1: float, projector_k1: float, scale: float = 1.0) -> tuple[Intrinsics, Intrinsics]:
    """The paper's rig at half camera resolution (times `scale`), with one radial term on each lens."""
    f, x, y = 895.55 * scale, 628.15 * scale, 527.15 * scale
    size = round(1224 * scale), round(1024 * scale)
    return (
        Intrinsics(*size, (f, f), (x, y), (camera_k1, 0.0, 0.0, 0.0, 0.0)),
        Intrinsics(854, 480, (1247.3, 1247.3), (377.1, 234.0), (projector_k1, 0.0, 0.0, 0.0, 0.0)),
    )


def render(
    rng: np.random.Generator,
    room: Room,
    calibration: Calibration,
    camera_to_world: tuple[Floats, Floats],
    *,
    noise_px: float,
    outliers: float = 0.0,
    crease_px: float = 0.0,
    with_sigma: bool = False,
) -> Scene:
    """Matches on the camera's pixel grid. `camera_to_world`: (rotation, camera centre)."""
    camera, projector = calibration.camera, calibration.projector
    turn, eye = camera_to_world
    x, y = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    rays = camera.unproject(np.stack([x.ravel(), y.ravel()], axis=1))
    depth, surface = room.cast(eye, rays @ turn.T)
    in_camera = rays * np.where(np.isfinite(depth), depth, 1.0)[:, None]
    projected = projector.project(in_camera @ calibration.rotation.T + calibration.translation)
    with np.errstate(invalid="ignore"):
        seen = (surface >= 0) & np.all((projected > 0) & (projected < (projector.width - 1, projector.height - 1)), 1)
    seen[seen] = room.lit(in_camera[seen] @ turn.T + eye, turn @ calibration.projector_centre + eye)
    bias = crease_px * _near_crease(surface.reshape(camera.height, camera.width), 3.0).ravel()[seen]
    camera_px = np.stack([x.ravel(), y.ravel()], axis=1)[seen]
    surface = surface[seen].copy()
    sigma = np.full(len(camera_px), noise_px)
    if with_sigma:
        sigma *= np.exp(rng.normal(0, 0.3, len(sigma)))
    pixels = projected[seen] + rng.normal(size=(len(sigma), 2)) * sigma[:, None]
    pixels += bias[:, None] * _unit(rng.normal(size=2))
    wrong = rng.random(len(surface)) < outliers
    far = rng.random(len(surface)) < 0.3
    pixels[wrong & far] = rng.uniform((0, 0), (projector.width, projector.height), (int((wrong & far).sum()), 2))
    pixels[wrong & ~far] += rng.normal(0, 8.0, (int((wrong & ~far).sum()), 2))
    surface[wrong] = OUTLIER
    return Scene(Matches(camera_px, pixels, None, sigma if with_sigma else None), surface, room, calibration)


def _near_crease(surface: Ints, reach_px: float) -> Floats:
    """1 at a border between two surfaces, falling to 0 at `reach_px` from it, (H, W)."""
    same = np.ones(surface.shape, np.uint8)
    same[:, 1:] &= (surface[:, 1:] == surface[:, :-1]).astype(np.uint8)
    same[1:] &= (surface[1:] == surface[:-1]).astype(np.uint8)
    away = cv2.distanceTransform(same, cv2.DIST_L2, 3).astype(np.float64)
    return np.clip(1 - away / reach_px, 0, 1)


def _unit(vector: Floats) -> Floats:
    return vector / np.linalg.norm(vector)


def place_rig(
    rng: np.random.Generator,
    devices: tuple[Intrinsics, Intrinsics],
    eye: Floats,
    target: Floats,
    baseline: float,
) -> tuple[Calibration, tuple[Floats, Floats]]:
    """A camera at `eye` looking at `target`, and a projector `baseline` metres aside looking there too."""
    up = np.array([0.0, 0.0, 1.0])
    aside = np.cross(target - eye, rng.normal(0, 0.5, 3) + up)
    projector_eye = eye + baseline * _unit(aside)
    spread = 0.04 * np.linalg.norm(eye - target)
    world_to_camera = rotation_to(eye, target + rng.normal(0, spread, 3), up, rng.normal(0, 0.15))
    world_to_projector = rotation_to(projector_eye, target + rng.normal(0, spread, 3), up, rng.normal(0, 0.15))
    calibration = Calibration(
        *devices, world_to_projector @ world_to_camera.T, world_to_projector @ (eye - projector_eye), unit="m"
    )
    return calibration, (world_to_camera.T, eye)


def furnished_room(rng: np.random.Generator, *, scale: float = 1.0, hidden_vertex: bool | None = None) -> Scene:
    """A room's corner with parallel and yawed boxes and often a sphere, matches with 0.03 to 0.3 px of noise.

    `hidden_vertex`: whether a box stands in the corner; None leaves it to chance.
    """
    while True:
        devices = paper_rig(rng.uniform(-0.1, 0.05), rng.uniform(-0.1, 0.05), scale)
        eye = rng.uniform(1.8, 4.0) * _unit(rng.uniform(0.35, 1.0, 3))
        reach = float(np.linalg.norm(eye))
        calibration, pose = place_rig(rng, devices, eye, reach * rng.uniform(0.0, 0.25, 3), rng.uniform(0.25, 0.6))
        hidden = rng.random() < 0.3 if hidden_vertex is None else hidden_vertex
        scene = render(
            rng,
            Room(furniture(rng, reach, hidden), ball(rng, reach) if rng.random() < 0.6 else None),
            calibration,
            pose,
            noise_px=float(np.exp(rng.uniform(np.log(0.03), np.log(0.3)))),
            outliers=rng.uniform(0, 0.05),
            crease_px=rng.uniform(0, 0.3),
            with_sigma=bool(rng.random() < 0.5),
        )
        if len(scene.surface) > 20_000 * scale**2 and all(np.mean(scene.surface == wall) > 0.04 for wall in range(3)):
            return scene


def furniture(rng: np.random.Generator, reach: float, hides_vertex: bool) -> tuple[Box, ...]:
    """One to four boxes on the floor, half of them turned, some against a wall; and one in the corner or not."""
    boxes = []
    for _ in range(rng.integers(1, 5)):
        size = reach * rng.uniform(0.06, 0.22, 3)
        yaw = rng.uniform(-0.6, 0.6) if rng.random() < 0.5 else 0.0
        place = reach * rng.uniform(0.02, 0.4, 2)
        if rng.random() < 0.4:
            place[rng.integers(2)] = 0.0
        half = size[:2] / 2 if yaw == 0 else np.full(2, np.hypot(*size[:2]) / 2)
        boxes.append(Box(np.array([*(place + half), size[2] / 2]), size, yaw))
    if hides_vertex:
        size = reach * rng.uniform(0.1, 0.2, 3)
        boxes.append(Box(size / 2 + 1e-3, size))
    return tuple(boxes)


def ball(rng: np.random.Generator, reach: float) -> tuple[Floats, float]:
    """A sphere on the floor: centre and radius."""
    radius = reach * rng.uniform(0.03, 0.1)
    return np.array([*(reach * rng.uniform(0.05, 0.35, 2) + radius), radius]), radius


def plain_room(
    rng: np.random.Generator,
    walls: tuple[bool, bool, bool] = (True, True, True),
    *,
    boxes: tuple[Box, ...] = (),
    sphere: tuple[Floats, float] | None = None,
    look_at: tuple[float, float, float] = (0.1, 0.1, 0.1),
    baseline: float = 0.4,
    lens_k1: float = -0.05,
    scale: float = 0.5,
) -> Scene:
    """Some of the three walls, seen from 2.5 m towards `look_at` (metres), with 0.1 px of noise and 2 % outliers."""
    devices = paper_rig(lens_k1, lens_k1, scale)
    eye = 2.5 * _unit(np.array([1.0, 0.8, 0.7]))
    calibration, pose = place_rig(rng, devices, eye, np.array(look_at), baseline)
    return render(rng, Room(boxes, sphere, walls), calibration, pose, noise_px=0.1, outliers=0.02, crease_px=0.1)


def box_on_table(rng: np.random.Generator, *, scale: float = 1.0, noise_px: float = 0.1) -> Scene:
    """Three faces of a yawed box, seen from outside, on a table that goes on behind it."""
    while True:
        devices = paper_rig(rng.uniform(-0.1, 0.05), rng.uniform(-0.1, 0.05), scale)
        distance = rng.uniform(1.0, 2.5)
        size = distance * rng.uniform(0.2, 0.4, 3)
        box = Box(np.array([3.0, 3.0, size[2] / 2]), size, rng.uniform(0, 1.5))
        azimuth, elevation = rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 1.0)
        ray = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
        eye = box.centre + distance * _unit(ray)
        calibration, pose = place_rig(rng, devices, eye, box.centre, distance * rng.uniform(0.1, 0.3))
        room = Room((box,), None, (False, False, True), np.array([6.0, 6.0, 6.0]))
        scene = render(rng, room, calibration, pose, noise_px=noise_px, outliers=0.02, crease_px=0.2)
        visible = [s for s in range(3, 9) if np.mean(scene.surface == s) > 0.05]
        if len(visible) == 3:
            return scene


@dataclass(frozen=True)
class Score:
    """`surfaces`: the true surface of faces 0, 1, 2 (that of most of their matches); `wrong`: share of the labelled
    matches that are on another; `labelled` (3,): share of each surface's matches that got its label; `off_square_deg`:
    how far from perpendicular the three surfaces really are.
    """

    surfaces: tuple[int, int, int]
    wrong: float
    labelled: Floats
    off_square_deg: float


def score(scene: Scene, face: Ints) -> Score:
    """Compare labels (N,) with the truth, whatever the order of the faces."""
    surfaces, wrong, labelled = [], 0, []
    for label in range(3):
        values, counts = np.unique(scene.surface[face == label], return_counts=True)
        surface = int(values[np.argmax(counts)])
        surfaces.append(surface)
        wrong += int(counts.sum() - counts.max())
        labelled.append(float(np.mean(face[scene.surface == surface] == label)))
    normals = np.stack([_normal(scene.room, surface) for surface in surfaces])
    off = np.degrees(np.arcsin(np.clip(np.abs(normals @ normals.T - np.eye(3)).max(), 0, 1)))
    a, b, c = surfaces
    return Score((a, b, c), wrong / np.count_nonzero(face >= 0), np.array(labelled), float(off))


def _normal(room: Room, surface: int) -> Floats:
    if surface < 3:
        return np.eye(3)[surface]
    if surface == SPHERE:
        return np.full(3, 3**-0.5)
    box = room.boxes[(surface - 3) // 6]
    return Rotation.from_euler("z", box.yaw).as_matrix()[:, (surface - 3) % 6 // 2]
