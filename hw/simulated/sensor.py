"""The camera's sensor: exposure, shot and read noise, quantisation."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from calib.numerics import Image
from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Light

# Electrons per microsecond for a brightness of one: white then needs some tens of milliseconds.
_ELECTRONS_PER_US = 2.0
_WHITE_LEVEL = 0.85
_WHITE_PERCENTILE = 99.5

Response = Literal["linear", "srgb", "photo"]


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
