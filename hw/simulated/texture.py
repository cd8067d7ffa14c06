"""Albedo: the share of light that each point of a surface reflects."""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats, Ints
from hw.simulated.scene import Scene

_FINE_M = 0.0025
_COARSE_M = 0.01
_LARGE_M2 = 4.0  # larger than any side of furniture
_GRAIN_SIZE = 512
_GRAIN_SIGMA = 0.035
_POSTERS_PER_WALL = 2
_BLOB_TEXELS = (2.0, 4.0, 8.0, 16.0, 32.0)
_PATTERN_SIGMA = 0.3  # of the logarithm of the albedo

Raster = NDArray[np.float32]


@dataclass(frozen=True)
class Texture:
    """Albedo of every surface as small images, concatenated in one vector `texels`.

    Per surface: `start` of its image in the vector, `shape` (2, surfaces) in texels along u and v, and `texel_m`, the
    side of a texel.
    """

    scene: Scene
    texels: Raster
    start: Ints
    shape: Ints
    texel_m: Floats

    def albedo(self, surface: Ints, uv: Floats) -> Floats:
        """Albedo (n,) at (u, v) (2, n) in metres on surfaces (n,)."""
        nu, nv = self.shape[:, surface]
        column, row = (uv / self.texel_m[surface]).astype(np.int32)
        np.clip(column, 0, nu - 1, out=column)
        np.clip(row, 0, nv - 1, out=row)
        albedo: Floats = self.texels[self.start[surface] + row * nu + column].astype(np.float64)
        return albedo


def paint(
    scene: Scene, rng: np.random.Generator, albedo: float | None, wallpaper: np.random.Generator | None = None
) -> Texture:
    """Plaster, posters, floorboards, cardboard and doors of a cupboard. `albedo`: the mean of each face of the corner.

    `wallpaper`: random numbers of an additional pattern on the faces of the corner; None for no pattern.
    """
    grain = _grain(rng)
    bases = np.full(3, albedo) if albedo is not None else rng.uniform((0.55, 0.55, 0.35), (0.8, 0.8, 0.6))
    large = scene.sizes.prod(axis=1) > _LARGE_M2
    texel_m = np.array(
        [_COARSE_M if 3 <= s < 6 or (s > 6 and large[s]) else _FINE_M for s in range(scene.surface_count)]
    )
    shape = np.ceil(scene.sizes / texel_m[:, None]).astype(np.int32)
    images = []
    for surface, (nu, nv) in enumerate(shape):
        image = _plain(rng, grain, (nv, nu))
        if surface < 2:
            # Rows run along z. On WALL_Y, z is u, hence the transpose.
            upright = image if surface == 0 else image.T
            _hang_posters(rng, upright)
            _finish(image, bases[surface], wallpaper)
        elif surface == 2:
            _lay_boards(rng, image)
            _finish(image, bases[surface], wallpaper)
        elif surface < 6:
            image *= rng.uniform(0.5, 0.8)
        elif surface in scene.spheres:
            image[:] = 0.75
        else:
            _tape(rng, image)
            image *= rng.uniform(0.4, 0.7)
        images.append(np.clip(image, 0.02, 0.97))
    start = np.concatenate([[0], np.cumsum([image.size for image in images])[:-1]]).astype(np.int32)
    texels = np.concatenate([image.ravel() for image in images]).astype(np.float32)
    return Texture(scene, texels, start, shape.T.copy(), texel_m)


def _grain(rng: np.random.Generator) -> Raster:
    """Periodic noise with a 1/f spectrum and mean 1, as on plaster and cardboard."""
    spectrum = np.fft.rfft2(rng.standard_normal((_GRAIN_SIZE, _GRAIN_SIZE)))
    frequency = np.hypot(np.fft.fftfreq(_GRAIN_SIZE)[:, None], np.fft.rfftfreq(_GRAIN_SIZE)[None, :])
    frequency[0, 0] = np.inf
    noise = np.fft.irfft2(spectrum / frequency)
    noise *= _GRAIN_SIGMA / noise.std()
    return (1.0 + noise).astype(np.float32)


def _plain(rng: np.random.Generator, grain: Raster, shape: tuple[int, int]) -> Raster:
    shifted = np.roll(grain, rng.integers(0, _GRAIN_SIZE, 2), axis=(0, 1))
    tiles = [-(-size // _GRAIN_SIZE) for size in shape]
    return np.tile(shifted, tiles)[: shape[0], : shape[1]]


def _finish(face: Raster, mean: float, wallpaper: np.random.Generator | None) -> None:
    if wallpaper is not None:
        face *= _pattern(wallpaper, face.shape)
    _scale_to(face, mean)


def _pattern(rng: np.random.Generator, shape: tuple[int, ...]) -> Raster:
    """Blobs of several sizes, equally strong at each: features for a detector, as on a wallpaper or carpet."""
    pattern = np.zeros(shape, np.float32)
    for blob_texels in _BLOB_TEXELS:
        noise = cv2.GaussianBlur(rng.standard_normal(shape, np.float32), (0, 0), blob_texels)
        pattern += noise / noise.std()
    brightness: Raster = np.exp(_PATTERN_SIGMA * pattern / pattern.std())
    return brightness


def _scale_to(image: Raster, mean: float) -> None:
    image *= mean / image.mean()


def _hang_posters(rng: np.random.Generator, wall: Raster) -> None:
    """Framed prints of stripes, some of them within the reach of the projector; wall rows run upwards."""
    for _ in range(_POSTERS_PER_WALL):
        width, height = (rng.uniform((0.25, 0.3), (0.6, 0.8)) / _FINE_M).astype(int)
        left = int(rng.uniform(0.3, 2.5) / _FINE_M)
        bottom = int(rng.uniform(0.5, 1.2) / _FINE_M)
        poster = wall[bottom : bottom + height, left : left + width]
        poster *= rng.uniform(0.4, 0.6)
        frame = int(0.03 / _FINE_M)
        picture = poster[frame:-frame, frame:-frame]
        edges = np.sort(rng.integers(0, max(picture.shape[0], 1), 5))
        for low, high in pairwise(edges):
            picture[low:high] *= rng.uniform(1.0, 2.0)
    wall[: int(0.07 / _FINE_M)] *= 0.8  # skirting board


def _lay_boards(rng: np.random.Generator, floor: Raster) -> None:
    width, length = int(0.14 / _FINE_M), int(1.2 / _FINE_M)
    for row in range(0, floor.shape[0], width):
        for column in range(-int(rng.integers(length)), floor.shape[1], length):
            board = floor[row : row + width, max(column, 0) : column + length]
            board *= rng.uniform(0.88, 1.12)
            board[:1] *= 0.7
            board[:, :1] *= 0.7


def _tape(rng: np.random.Generator, face: Raster) -> None:
    """A strip of paper tape across a box."""
    width = int(0.05 / _FINE_M)
    middle = int(rng.uniform(0.3, 0.7) * face.shape[0])
    face[middle : middle + width] *= 1.25
