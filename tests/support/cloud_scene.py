"""A synthetic scene with ground truth: the corner of a room and a sphere, on the camera's pixel grid."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration, Corner, Intrinsics, Matches
from tests.support.room import SPHERE, Ball, Placed, Room, seen

CAMERA = Intrinsics(408, 342, (299.0, 299.0), (209.0, 176.0), (-0.05, 0.0, 0.0, 0.0, 0.0))
PROJECTOR = Intrinsics(854, 480, (900.0, 900.0), (377.1, 234.0), (0.02, 0.0, 0.0, 0.0, 0.0))
SPHERE_RADIUS_M = 0.15
FIRST_PLACE = (1.5, 1.3, 1.2)


@dataclass(frozen=True)
class Scene:
    """`points`, `normals` (N, 3) and `surface` (N,) of each match: 0, 1, 2 the walls, 3 the sphere."""

    matches: Matches
    calibration: Calibration
    corner: Corner
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    surface: NDArray[np.int32]
    texture: NDArray[np.uint8]
    sphere_centre: NDArray[np.float64]


def room(
    camera: Intrinsics = CAMERA,
    projector: Intrinsics = PROJECTOR,
    noise_px: float = 0.05,
    seed: int = 0,
    at: tuple[float, float, float] = FIRST_PLACE,
) -> Scene:
    """A concave corner 2.5 m away, a sphere in front of it, and a projector 0.4 m beside the camera, which is `at` a
    place in the frame of the corner.
    """
    target = np.array([0.3, 0.25, 0.25])
    source = Placed.looking(np.array([1.75, 1.0, 1.3]), np.array([0.3, 0.2, 0.25]))
    rig = Placed.looking(np.array(FIRST_PLACE), target).into(source)
    calibration, eye = Calibration(camera, projector, rig, unit="m"), Placed.looking(np.array(at), target)
    corner = Corner(-eye.rotation @ eye.eye, eye.rotation.T.copy())
    ball = Ball(np.array([0.5, 0.4, 0.4]), SPHERE_RADIUS_M)
    view = seen(Room(ball=ball), calibration, eye)

    centre = eye.rotation @ (ball.centre - eye.eye)
    is_ball = view.surface == SPHERE
    surface = np.where(is_ball, 3, view.surface).astype(np.int32)
    outwards = (view.points - centre) / SPHERE_RADIUS_M
    normals = np.where(is_ball[:, None], outwards, corner.normals[np.minimum(surface, 2)])
    facing = -np.sum(normals * view.points, axis=1) / np.linalg.norm(view.points, axis=1)
    shade = np.where(view.lit, 90 + 80 * np.clip(facing, 0, 1), 8)
    tint = np.array([[0.8, 0.9, 1.0], [0.95, 1.0, 0.9], [0.85, 0.95, 0.95], [0.4, 0.7, 1.0]])[surface]
    texture = (shade[:, None] * tint).astype(np.uint8).reshape(camera.height, camera.width, 3)
    lit = view.lit
    noise = np.random.default_rng(seed).normal(0, noise_px, (int(lit.sum()), 2))
    face = np.where(is_ball, -1, surface).astype(np.int32)
    return Scene(
        Matches(view.camera_px[lit], view.projector_px[lit] + noise, face[lit]),
        calibration,
        corner,
        view.points[lit],
        normals[lit],
        surface[lit],
        texture,
        centre,
    )


def with_mistakes(scene: Scene, share: float, seed: int = 1) -> tuple[Scene, NDArray[np.bool_]]:
    """The scene with a share of its matches moved by 8 to 200 projector pixels, and their mask (N,)."""
    rng = np.random.default_rng(seed)
    wrong = rng.random(len(scene.matches)) < share
    moved = scene.matches.projector_px.copy()
    angle, length = rng.uniform(0, 2 * np.pi, int(wrong.sum())), rng.uniform(8, 200, int(wrong.sum()))
    moved[wrong] += length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return replace(scene, matches=replace(scene.matches, projector_px=moved)), wrong
