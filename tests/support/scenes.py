"""Rooms with furniture, seen by a camera and lit by a projector: matches with true labels."""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.geometry import Calibration, Intrinsics, Matches
from calib.numerics import Floats, Ints
from tests.support.room import NOTHING, UP, Ball, Box, Placed, Room, seen

OUTLIER = NOTHING


@dataclass(frozen=True)
class Scene:
    """`surface` (N,): the true surface of each match, OUTLIER where the match is wrong."""

    matches: Matches
    surface: Ints
    room: Room
    calibration: Calibration


def paper_rig(camera_k1: float, projector_k1: float, scale: float = 1.0) -> tuple[Intrinsics, Intrinsics]:
    """The paper's rig at half the camera resolution (times `scale`), with one radial term per lens."""
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
    camera: Placed,
    *,
    noise_px: float,
    outliers: float = 0.0,
    crease_px: float = 0.0,
    with_sigma: bool = False,
) -> Scene:
    """Matches on the camera's pixel grid."""
    view = seen(room, calibration, camera)
    projector, lit = calibration.projector, view.lit
    shape = calibration.camera.height, calibration.camera.width
    bias = crease_px * _near_crease(view.surface.reshape(shape), 3.0).ravel()[lit]
    surface = view.surface[lit].copy()
    sigma = np.full(len(surface), noise_px)
    if with_sigma:
        sigma *= np.exp(rng.normal(0, 0.3, len(sigma)))
    pixels = view.projector_px[lit] + rng.normal(size=(len(sigma), 2)) * sigma[:, None]
    pixels += bias[:, None] * _unit(rng.normal(size=2))
    wrong = rng.random(len(surface)) < outliers
    far = rng.random(len(surface)) < 0.3
    pixels[wrong & far] = rng.uniform((0, 0), (projector.width, projector.height), (int((wrong & far).sum()), 2))
    pixels[wrong & ~far] += rng.normal(0, 8.0, (int((wrong & ~far).sum()), 2))
    surface[wrong] = OUTLIER
    matches = Matches(view.camera_px[lit], pixels, None, sigma if with_sigma else None)
    return Scene(matches, surface, room, calibration)


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
) -> tuple[Calibration, Placed]:
    """A camera at `eye` facing `target`, and a projector `baseline` metres beside it facing the same."""
    aside = np.cross(target - eye, rng.normal(0, 0.5, 3) + UP)
    spread = 0.04 * np.linalg.norm(eye - target)
    camera, projector = (
        Placed.looking(place, target + rng.normal(0, spread, 3), rng.normal(0, 0.15))
        for place in (eye, eye + baseline * _unit(aside))
    )
    return Calibration(*devices, camera.into(projector), unit="m"), camera


def furnished_room(rng: np.random.Generator, *, scale: float = 1.0, hidden_vertex: bool | None = None) -> Scene:
    """A room's corner with parallel and rotated boxes and often a sphere; matches with 0.03 to 0.3 px of noise.

    `hidden_vertex`: whether a box stands in the corner; None for random.
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
    """One to four boxes on the floor, half of them rotated, some against a wall; and optionally one in the corner."""
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


def ball(rng: np.random.Generator, reach: float) -> Ball:
    """A sphere on the floor."""
    radius = reach * rng.uniform(0.03, 0.1)
    return Ball(np.array([*(reach * rng.uniform(0.05, 0.35, 2) + radius), radius]), radius)


def plain_room(
    rng: np.random.Generator,
    walls: tuple[bool, bool, bool] = (True, True, True),
    *,
    boxes: tuple[Box, ...] = (),
    sphere: Ball | None = None,
    look_at: tuple[float, float, float] = (0.1, 0.1, 0.1),
    baseline: float = 0.4,
    lens_k1: float = -0.05,
    scale: float = 0.5,
) -> Scene:
    """Some of the three walls, from 2.5 m, facing `look_at` (metres), with 0.1 px of noise and 2 % outliers."""
    devices = paper_rig(lens_k1, lens_k1, scale)
    eye = 2.5 * _unit(np.array([1.0, 0.8, 0.7]))
    calibration, pose = place_rig(rng, devices, eye, np.array(look_at), baseline)
    return render(rng, Room(boxes, sphere, walls), calibration, pose, noise_px=0.1, outliers=0.02, crease_px=0.1)


def box_on_table(rng: np.random.Generator, *, scale: float = 1.0, noise_px: float = 0.1) -> Scene:
    """Three faces of a rotated box, seen from outside, on a table that extends behind it."""
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
    """Compare labels (N,) with the truth, for any order of the faces."""
    surfaces, wrong, labelled = [], 0, []
    for label in range(3):
        values, counts = np.unique(scene.surface[face == label], return_counts=True)
        surface = int(values[np.argmax(counts)])
        surfaces.append(surface)
        wrong += int(counts.sum() - counts.max())
        labelled.append(float(np.mean(face[scene.surface == surface] == label)))
    normals = np.stack([scene.room.normal(surface) for surface in surfaces])
    off = np.degrees(np.arcsin(np.clip(np.abs(normals @ normals.T - np.eye(3)).max(), 0, 1)))
    a, b, c = surfaces
    return Score((a, b, c), wrong / np.count_nonzero(face >= 0), np.array(labelled), float(off))
