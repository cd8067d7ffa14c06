"""From the picture that a projector is shown to the light that leaves its lens."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from calib.numerics import Floats, Image
from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Indices, Light

_OVERSAMPLING = 3
_BORDER = 12  # black projector pixels around the picture, for light that blur spills over its edges
_PYRAMID_LEVELS = 7


@dataclass(frozen=True)
class PictureOptics:
    """Response and lens of a projector; a picture's pixels are squares of even brightness."""

    width: int
    height: int
    gamma: float
    contrast: float
    blur_px: float

    def under(self, settings: SimulatedRigSettings) -> "PictureOptics":
        """Those of a projector of the same size with other settings."""
        return replace(self, gamma=settings.gamma, contrast=settings.contrast, blur_px=settings.projector_blur_px)

    def linear(self, picture: Image) -> Light:
        """8-bit picture (H, W) → light (H, W) from 1 / contrast to 1."""
        black = 1.0 / self.contrast
        response = black + (1.0 - black) * np.linspace(0.0, 1.0, 256) ** self.gamma
        light: Light = response.astype(np.float32)[picture]
        return light

    def blurred(self, light: Light) -> Light:
        """Light (H, W) → a finer image of it behind the lens, as a vector (fine_count,)."""
        fine = cv2.resize(light, None, fx=_OVERSAMPLING, fy=_OVERSAMPLING, interpolation=cv2.INTER_NEAREST)
        border = _BORDER * _OVERSAMPLING
        fine = cv2.copyMakeBorder(fine, border, border, border, border, cv2.BORDER_CONSTANT, value=0.0)
        if self.blur_px > 0:
            fine = cv2.GaussianBlur(fine, (0, 0), self.blur_px * _OVERSAMPLING)
        return np.asarray(fine, np.float32).ravel()

    @property
    def fine_count(self) -> int:
        """Length of what `blurred` returns."""
        width, height = self._fine_size()
        return width * height

    def interpolate(self, pixels: Floats) -> tuple[Indices, Floats]:
        """Where in `blurred` the light of projector pixels (2, n) is: the four elements around each and their bilinear
        weights, (n, 4) and (n, 4). Pixels may be outside of the picture by less than `_BORDER` - 1.
        """
        width, _ = self._fine_size()
        position = (pixels + 0.5 + _BORDER) * _OVERSAMPLING - 0.5
        cell = np.floor(position).astype(np.int64)
        (right, down), (column, row) = position - cell, cell
        first = row * width + column
        texels = np.stack([first, first + 1, first + width, first + width + 1], axis=1)
        left, up = 1 - right, 1 - down
        return texels, np.stack([left * up, right * up, left * down, right * down], axis=1)

    def pyramid(self, light: Light) -> Light:
        """Light (H, W) → area averages over 1, 2, 4 … pixels, all levels in one vector (texels,)."""
        levels = [light]
        for width, height in self._level_sizes()[1:]:
            coarser = cv2.resize(levels[-1], (width, height), interpolation=cv2.INTER_AREA)
            levels.append(np.asarray(coarser, np.float32))
        return np.concatenate([level.ravel() for level in levels])

    @property
    def texel_count(self) -> int:
        """Length of a pyramid."""
        return sum(width * height for width, height in self._level_sizes())

    def texels(self, pixels: Floats, footprint_px: Floats) -> Indices:
        """Which texel of the pyramid averages over about `footprint_px` (n,) pixels' width at pixels (2, n), (n,)."""
        sizes = np.array(self._level_sizes())
        starts = np.concatenate([[0], np.cumsum(sizes.prod(axis=1))])
        level = np.rint(np.log2(np.maximum(footprint_px, 1.0))).astype(int).clip(0, _PYRAMID_LEVELS - 1)
        width, height = sizes[level].T
        column = ((pixels[0] + 0.5) * width / self.width).astype(int).clip(0, width - 1)
        row = ((pixels[1] + 0.5) * height / self.height).astype(int).clip(0, height - 1)
        texels: Indices = starts[level] + row * width + column
        return texels

    def _level_sizes(self) -> list[tuple[int, int]]:
        return [(-(-self.width // 2**k), -(-self.height // 2**k)) for k in range(_PYRAMID_LEVELS)]

    def _fine_size(self) -> tuple[int, int]:
        return (self.width + 2 * _BORDER) * _OVERSAMPLING, (self.height + 2 * _BORDER) * _OVERSAMPLING
