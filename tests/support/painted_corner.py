"""Photos of a painted corner, with ground truth."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from calib.geometry import Intrinsics
from calib.numerics import Floats, Image
from tests.support.room import Placed, Room

CAMERA = Intrinsics(640, 480, (620.0, 620.0), (340.0, 224.0), (-0.03, 0.0, 0.0, 0.0, 0.0))
FIRST, SECOND, THIRD = np.array([1.6, 1.3, 1.2]), np.array([1.15, 1.75, 1.3]), np.array([1.5, 1.2, 1.75])
_TEXELS_PER_M = 320
_EXTENT_M = 3.0
_SUPERSAMPLING = 2


@dataclass(frozen=True)
class Walls:
    """Pictures of the walls, BGR; a wall without a picture is black."""

    pictures: tuple[Image | None, ...]


def painted(seed: int = 0, walls: tuple[int, ...] = (0, 1, 2)) -> Walls:
    """Blobs of many sizes on the walls with these numbers."""
    rng = np.random.default_rng(seed)
    return Walls(tuple(_blobs(rng) if wall in walls else None for wall in range(3)))


def photo(walls: Walls, eye: Floats, *, camera: Intrinsics = CAMERA, target: Floats | None = None) -> Image:
    """The view of a camera at `eye` facing `target` (the vertex), with slight noise."""
    placed = Placed.looking(eye, np.full(3, 0.15) if target is None else target)
    rays = _rays(camera) @ placed.rotation
    depth, wall = (of.reshape(rays.shape[:2]) for of in Room().cast(eye, rays.reshape(-1, 3)))
    points = eye + np.where(np.isfinite(depth), depth, 0.0)[..., None] * rays
    seen = np.zeros((*wall.shape, 3), np.float32)
    for number, picture in enumerate(walls.pictures):
        if picture is None:
            continue
        u, v = (points[..., axis].astype(np.float32) * _TEXELS_PER_M for axis in range(3) if axis != number)
        values = cv2.remap(picture.astype(np.float32), u, v, cv2.INTER_LINEAR)
        seen[wall == number] = values[wall == number]
    small = cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    noisy = small + np.random.default_rng(1).normal(0, 1.5, small.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def write_photos(folder: Path, *images: Image) -> list[Path]:
    """Write A.png, B.png and so on."""
    paths = [folder / f"{chr(ord('A') + number)}.png" for number in range(len(images))]
    for path, image in zip(paths, images, strict=True):
        cv2.imwrite(str(path), image)
    return paths


@cache
def _rays(camera: Intrinsics) -> Floats:
    """Several rays of each of a camera's pixels, (H, W, 3)."""
    fine = (np.arange(_SUPERSAMPLING) + 0.5) / _SUPERSAMPLING - 0.5
    x, y = (np.add.outer(np.arange(side), fine).ravel() for side in (camera.width, camera.height))
    return camera.unproject(np.stack(np.meshgrid(x, y), axis=-1))


def _blobs(rng: np.random.Generator) -> Image:
    side = int(_EXTENT_M * _TEXELS_PER_M)
    pattern = np.zeros((side, side), np.float32)
    for blob_texels in (2.0, 4.0, 8.0, 16.0):
        noise = cv2.GaussianBlur(rng.standard_normal((side, side), np.float32), (0, 0), blob_texels)
        pattern += noise / noise.std()
    grey = 120 + 28 * pattern
    tinted = grey[..., None] * rng.uniform(0.7, 1.1, 3)
    return np.clip(tinted, 0, 255).astype(np.uint8)
