"""From the 8-bit picture sent to a projector to the light that leaves its lens.

The camera's sensor: exposure, shot and read noise, quantisation.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from calib.numerics import Floats, Image
from hw.settings import PanelSettings, SimulatedRigSettings
from hw.simulated.arrays import Indices, Light

_OVERSAMPLING = 3
_BORDER = 12  # black projector pixels around the picture, into which blur spreads light
_PYRAMID_LEVELS = 7
_SHARPENED_PX = 1.0
# Electrons per microsecond for a brightness of one: white then needs some tens of milliseconds.
_ELECTRONS_PER_US = 2.0
_WHITE_LEVEL = 0.85
_WHITE_PERCENTILE = 99.5

Response = Literal["linear", "srgb", "photo"]


@dataclass(frozen=True)
class PictureOptics:
    """Electronics, panel and lens of a projector. A pixel is a square of uniform brightness.

    `sharpening`, `stripe_loss`: as in the settings. `homography` (3, 3): from the picture's pixels to the panel's;
    None for the identity.
    """

    width: int
    height: int
    gamma: float
    contrast: float
    blur_px: float
    sharpening: float = 0.0
    stripe_loss: float = 0.0
    homography: Floats | None = None

    def under(self, settings: SimulatedRigSettings) -> "PictureOptics":
        """The same projector with other settings."""
        default = settings.panel == PanelSettings()
        return replace(
            self,
            gamma=settings.gamma,
            contrast=settings.contrast,
            blur_px=settings.projector_blur_px,
            sharpening=settings.sharpening,
            stripe_loss=settings.stripe_loss,
            homography=None if default else panel_homography(settings.panel, self.width, self.height),
        )

    def linear(self, picture: Image) -> Light:
        """8-bit picture (H, W) → light (H, W) of the panel pixels, from 1 / contrast to 1."""
        levels = picture.astype(np.float32)
        if self.homography is not None:
            levels = np.asarray(cv2.warpPerspective(levels, self.homography, (self.width, self.height)), np.float32)
        if self.sharpening:
            soft = cv2.GaussianBlur(levels, (0, 0), _SHARPENED_PX, borderType=cv2.BORDER_REPLICATE)
            levels = np.clip(levels + np.float32(self.sharpening) * (levels - soft), 0, 255)
        black = 1.0 / self.contrast
        light: Light = (black + (1.0 - black) * (levels / np.float32(255)) ** np.float32(self.gamma)).astype(np.float32)
        return self._after_crosstalk(light) if self.stripe_loss else light

    def to_picture(self, pixels: Floats) -> Floats:
        """Panel pixels (2, n) → picture pixels (2, n)."""
        if self.homography is None:
            return pixels
        x, y, w = np.linalg.inv(self.homography) @ np.vstack([pixels, np.ones(pixels.shape[1])])
        return np.stack([x / w, y / w])

    def _after_crosstalk(self, light: Light) -> Light:
        """Each pixel loses a share of its excess over each of its four neighbours."""
        padded = np.pad(light, 1, mode="edge")
        neighbours = (padded[1:-1, :-2], padded[1:-1, 2:], padded[:-2, 1:-1], padded[2:, 1:-1])
        lost = sum(np.maximum(light - neighbour, 0) for neighbour in neighbours)
        remaining: Light = (
            light - np.float32(self.stripe_loss / 2) * lost
        )  # a stripe of one pixel has two dark neighbours
        return remaining

    def blurred(self, light: Light) -> Light:
        """Light (H, W) → oversampled image behind the lens, as a vector (fine_count,)."""
        fine = cv2.resize(light, None, fx=_OVERSAMPLING, fy=_OVERSAMPLING, interpolation=cv2.INTER_NEAREST)
        border = _BORDER * _OVERSAMPLING
        fine = cv2.copyMakeBorder(fine, border, border, border, border, cv2.BORDER_CONSTANT, value=0.0)
        if self.blur_px > 0:
            fine = cv2.GaussianBlur(fine, (0, 0), self.blur_px * _OVERSAMPLING)
        return np.asarray(fine, np.float32).ravel()

    @property
    def fine_count(self) -> int:
        """Length of the vector of `blurred`."""
        width, height = self._fine_size()
        return width * height

    def interpolate(self, pixels: Floats) -> tuple[Indices, Floats]:
        """The four elements of `blurred` around projector pixels (2, n), and their bilinear weights: (n, 4) and (n, 4).

        Pixels may be outside the picture by less than `_BORDER` − 1.
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
        """Length of the vector of `pyramid`."""
        return sum(width * height for width, height in self._level_sizes())

    def texels(self, pixels: Floats, footprint_px: Floats) -> Indices:
        """Indices (n,) of the texels of the pyramid that average over about `footprint_px` (n,) pixels around pixels
        (2, n).
        """
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


def panel_homography(settings: PanelSettings, width: int, height: int) -> Floats:
    """Homography (3, 3) from the picture's pixels to the panel's. A scale of one keeps the bottom edge."""
    across = settings.scale * settings.squeeze * (-1 if settings.mirrored else 1)
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    to_centre = np.array([[1.0, 0.0, -centre[0]], [0.0, 1.0, -centre[1]], [0.0, 0.0, 1.0]])
    # In units of half the height: the bottom, y = 1, is unchanged; the top, y = −1, is scaled by 1 − keystone.
    lean = (1 / (1 - settings.keystone) - 1) / 2
    wide = 1 + lean
    unit = np.diag([2 / height, 2 / height, 1.0])
    keystone = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -lean, wide]])
    homography: Floats = (
        np.linalg.inv(to_centre)
        @ np.linalg.inv(unit)
        @ keystone
        @ unit
        @ np.diag([across, settings.scale, 1.0])
        @ to_centre
    )
    return homography


@dataclass(frozen=True)
class Sensor:
    """Converts brightness to grey levels. Shot noise is normal with the variance of the Poisson distribution."""

    blur_px: float
    exposure_us: float
    bit_depth: int
    full_well_electrons: float
    read_noise_electrons: float
    response: Response = "linear"

    def electrons(self, brightness: Light) -> Light:
        """Expected electrons (H, W) for the brightness (H, W) of the pixels, with the blur of the camera's lens."""
        return self._through_lens(brightness) * np.float32(_ELECTRONS_PER_US * self.exposure_us)

    def read(self, electrons: Light, rng: np.random.Generator) -> Image:
        """One noisy image (H, W) for expected electrons (H, W); 16 bits per pixel if the sensor has more than 8."""
        return self.read_with(electrons, rng.standard_normal(electrons.shape, dtype=np.float32))

    def read_with(self, electrons: Light, noise: Light) -> Image:
        """One image (H, W) with given noise (H, W) of unit variance. Overwrites `noise`."""
        highest = 2**self.bit_depth - 1
        noise *= np.sqrt(electrons + np.float32(self.read_noise_electrons**2))
        noise += electrons
        noise *= np.float32(highest / self.full_well_electrons)
        if self.response != "linear":
            noise = np.float32(highest) * responded(np.clip(noise / np.float32(highest), 0, 1), self.response)
        np.rint(noise, out=noise)
        digits = np.clip(noise, 0, highest, out=noise)
        return digits.astype(np.uint8) if self.bit_depth == 8 else digits.astype(np.uint16)

    def _through_lens(self, brightness: Light) -> Light:
        if self.blur_px == 0:
            return brightness
        return np.asarray(cv2.GaussianBlur(brightness, (0, 0), self.blur_px), np.float32)


def responded(light: Light, response: Response) -> Light:
    """Grey levels 0 … 1 for light 0 … 1.

    "srgb" is the transfer function of sRGB (IEC 61966-2-1). "photo" averages it with a smoothstep of itself, as photo
    cameras add contrast.
    """
    if response == "linear":
        return light
    bright = 1.055 * np.maximum(light, 1e-6) ** np.float32(1 / 2.4) - 0.055
    level: Light = np.where(light <= 0.0031308, 12.92 * light, bright).astype(np.float32)
    return level if response == "srgb" else np.asarray(level * (1 + level * (3 - 2 * level)) / 2, np.float32)


def build_sensor(settings: SimulatedRigSettings, white: Light) -> Sensor:
    """A sensor. Unless the settings give an exposure, it is chosen for the brightness (H, W) of a white picture."""
    bright = float(np.percentile(white, _WHITE_PERCENTILE))
    suitable_us = _WHITE_LEVEL * settings.full_well_electrons / (_ELECTRONS_PER_US * bright)
    return Sensor(
        settings.camera_blur_px,
        suitable_us if settings.exposure_us is None else settings.exposure_us,
        settings.bit_depth,
        settings.full_well_electrons,
        settings.read_noise_electrons,
        settings.camera_response,
    )
