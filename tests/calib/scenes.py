"""Rooms with furniture, seen by a camera and lit by a projector: matches with true labels, by casting rays.

World: the walls are the planes x = 0, y = 0 and z = 0 (the floor), the room is the positive octant, lengths in metres.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calib.arrays import Bools, Floats, Ints
from calib.calibration import Calibration
from calib.camera import Intrinsics
from calib.matches import Matches
from calib.synthetic import look_at

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
    world_to_camera = look_at(eye, target + rng.normal(0, spread, 3), up, rng.normal(0, 0.15))
    world_to_projector = look_at(projector_eye, target + rng.normal(0, spread, 3), up, rng.normal(0, 0.15))
    calibration = Calibration(
        *devices, world_to_projector @ world_to_camera.T, world_to_projector @ (eye - projector_eye), unit="m"
    )
    return calibration, (world_to_camera.T, eye)


def furnished_room(rng: np.random.Generator, *, scale: float = 1.0, noise_px: float | None = None) -> Scene:
    """A room's corner with parallel and yawed boxes, often a sphere, now and then a hidden vertex."""
    while True:
        devices = paper_rig(rng.uniform(-0.1, 0.05), rng.uniform(-0.1, 0.05), scale)
        direction = rng.uniform(0.35, 1.0, 3)
        eye = rng.uniform(1.8, 4.0) * _unit(direction)
        target = rng.uniform(0.0, 0.25, 3) * np.linalg.norm(eye)
        calibration, pose = place_rig(rng, devices, eye, target, rng.uniform(0.25, 0.6))
        room = Room(_furniture(rng, np.linalg.norm(eye)), _ball(rng, eye) if rng.random() < 0.6 else None)
        scene = render(
            rng,
            room,
            calibration,
            pose,
            noise_px=float(np.exp(rng.uniform(np.log(0.03), np.log(0.3)))) if noise_px is None else noise_px,
            outliers=rng.uniform(0, 0.05),
            crease_px=rng.uniform(0, 0.3),
            with_sigma=bool(rng.random() < 0.5),
        )
        if _usable(scene, (0, 1, 2), 0.04):
            return scene


def _furniture(rng: np.random.Generator, reach: float) -> tuple[Box, ...]:
    boxes = []
    for _ in range(rng.integers(1, 5)):
        size = reach * rng.uniform(0.06, 0.22, 3)
        yaw = rng.uniform(-0.6, 0.6) if rng.random() < 0.5 else 0.0
        place = reach * rng.uniform(0.02, 0.4, 2)
        if rng.random() < 0.4:  # against a wall
            place[rng.integers(2)] = 0.0
        reach_xy = size[:2] / 2 if yaw == 0 else np.full(2, np.hypot(*size[:2]) / 2)
        boxes.append(Box(np.array([*(place + reach_xy), size[2] / 2]), size, yaw))
    if rng.random() < 0.3:  # hides the vertex
        size = reach * rng.uniform(0.1, 0.2, 3)
        boxes.append(Box(size / 2 + 1e-3, size))
    return tuple(boxes)


def _ball(rng: np.random.Generator, eye: Floats) -> tuple[Floats, float]:
    reach = float(np.linalg.norm(eye))
    radius = reach * rng.uniform(0.03, 0.1)
    return np.array([*(reach * rng.uniform(0.05, 0.35, 2) + radius), radius]), radius


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


def _usable(scene: Scene, surfaces: tuple[int, ...], share: float) -> bool:
    n = len(scene.surface)
    return n > 20_000 and all(np.count_nonzero(scene.surface == s) > share * n for s in surfaces)
