"""A made-up scene with everything known: the corner of a room and a sphere in it, seen on the camera's pixel grid.

Nothing is shared with the code under test but the camera model: rays are cast from the camera, their points projected
into the projector, and what the projector does not reach is left out.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.geometry.calibration import Calibration
from calib.geometry.camera import Intrinsics
from calib.geometry.corner import Corner
from calib.geometry.matches import Matches
from calib.synthetic.captures import look_at

CAMERA = Intrinsics(408, 342, (299.0, 299.0), (209.0, 176.0), (-0.05, 0.0, 0.0, 0.0, 0.0))
PROJECTOR = Intrinsics(854, 480, (900.0, 900.0), (377.1, 234.0), (0.02, 0.0, 0.0, 0.0, 0.0))
SPHERE_RADIUS_M = 0.15


@dataclass(frozen=True)
class Scene:
    """`points`, `normals` (N, 3) and `surface` (N,): 0, 1, 2 the walls, 3 the sphere, of each match."""

    matches: Matches
    calibration: Calibration
    corner: Corner
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    surface: NDArray[np.int32]
    texture: NDArray[np.uint8]
    sphere_centre: NDArray[np.float64]


def room(
    camera: Intrinsics = CAMERA, projector: Intrinsics = PROJECTOR, noise_px: float = 0.05, seed: int = 0
) -> Scene:
    """A concave corner 2.5 m away, a sphere before it, and a projector 0.4 m beside the camera."""
    rng = np.random.default_rng(seed)
    eye, projector_eye = np.array([1.5, 1.3, 1.2]), np.array([1.75, 1.0, 1.3])
    up = np.array([0.0, 0.0, 1.0])
    to_camera = look_at(eye, np.array([0.3, 0.25, 0.25]), up)
    to_projector = look_at(projector_eye, np.array([0.3, 0.2, 0.25]), up)
    rotation, translation = to_projector @ to_camera.T, to_projector @ (eye - projector_eye)
    corner = Corner(-to_camera @ eye, to_camera.T.copy())
    sphere = to_camera @ (np.array([0.5, 0.4, 0.4]) - eye)

    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1).reshape(-1, 2).astype(float)
    rays = camera.unproject(pixels)
    points, normals, surface = _cast(np.zeros(3), rays, corner, sphere)
    in_projector = points @ rotation.T + translation
    projector_px = projector.project(in_projector)
    centre = -rotation.T @ translation
    lit_first, _, _ = _cast(centre, points - centre, corner, sphere)
    with np.errstate(invalid="ignore"):
        inside = np.all((projector_px >= 0) & (projector_px <= (projector.width - 1, projector.height - 1)), axis=1)
        lit = inside & (np.linalg.norm(lit_first - points, axis=1) < 1e-6)

    shade = np.where(
        lit, 90 + 80 * np.clip(-np.sum(normals * points, axis=1) / np.linalg.norm(points, axis=1), 0, 1), 8
    )
    tint = np.array([[0.8, 0.9, 1.0], [0.95, 1.0, 0.9], [0.85, 0.95, 0.95], [0.4, 0.7, 1.0]])[surface]
    texture = (shade[:, None] * tint).astype(np.uint8).reshape(camera.height, camera.width, 3)
    noise = rng.normal(0, noise_px, (int(lit.sum()), 2))
    face = np.where(surface < 3, surface, -1).astype(np.int32)
    return Scene(
        Matches(pixels[lit], projector_px[lit] + noise, face[lit]),
        Calibration(camera, projector, rotation, translation, unit="m"),
        corner,
        points[lit],
        normals[lit],
        surface[lit],
        texture,
        sphere,
    )


def _cast(
    origin: NDArray[np.float64], rays: NDArray[np.float64], corner: Corner, sphere: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """First hits of rays (N, 3) from `origin`: points (N, 3), outward normals (N, 3), surfaces (N,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = corner.normals @ (corner.vertex - origin) / (rays @ corner.normals.T)
        a, b = np.sum(rays * rays, axis=1), rays @ (origin - sphere)
        c = np.sum((origin - sphere) ** 2) - SPHERE_RADIUS_M**2
        ball = (-b - np.sqrt(b * b - a * c)) / a
    lengths = np.column_stack([walls, ball])
    lengths[~(lengths > 1e-9)] = np.inf
    surface = np.argmin(lengths, axis=1).astype(np.int32)
    points = origin + lengths[np.arange(len(rays)), surface, None] * rays
    normals = np.where(
        (surface == 3)[:, None], (points - sphere) / SPHERE_RADIUS_M, corner.normals[np.minimum(surface, 2)]
    )
    return points, normals, surface


def with_mistakes(scene: Scene, share: float, seed: int = 1) -> tuple[Scene, NDArray[np.bool_]]:
    """The scene with a share of its matches moved by 8 to 200 projector pixels, and which they are, (N,)."""
    rng = np.random.default_rng(seed)
    wrong = rng.random(len(scene.matches)) < share
    moved = scene.matches.projector_px.copy()
    angle, length = rng.uniform(0, 2 * np.pi, int(wrong.sum())), rng.uniform(8, 200, int(wrong.sum()))
    moved[wrong] += length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return replace(scene, matches=replace(scene.matches, projector_px=moved)), wrong
