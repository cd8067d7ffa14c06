"""Direct illumination: the projector's light from the lens to a surface, and the flicker of its lamp."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Ints
from hw.settings import SimulatedRigSettings
from hw.simulated.arrays import Light
from hw.simulated.device import PlacedDevice
from hw.simulated.scene import Scene

_VIGNETTING = 0.25
# Blur of at most 4 pixels spreads the light of the outermost pixels this far beyond the picture's edge.
SPILL_PX = 10.0


@dataclass(frozen=True)
class ProjectorLight:
    """Light of a projector in a scene. A picture of ones has the irradiance 1 on a screen at 1 m on the axis."""

    scene: Scene
    projector: PlacedDevice

    def direct(self, surface: Ints, points: Floats) -> tuple[Floats, Floats]:
        """The projector's pixels (2, n) for points (3, n) on surfaces (n,), and the irradiance (n,) per unit of their
        light.

        The irradiance is zero where the surface faces away, lies outside the picture or is in shadow. A projector
        spreads each pixel's power over the pixel's solid angle. Equal pixels on a plane have solid angles that decrease
        with cos³ of the angle to the axis. Hence the irradiance is (n · s) / z³ times the vignetting, where s is the
        vector to the projector and z the depth along its axis.
        """
        pixels, irradiance = self.unoccluded(points, self.scene.normals(surface, points))
        reached = np.flatnonzero(irradiance)
        irradiance[reached[self.scene.occluded(points[:, reached], self.projector.centre)]] = 0.0
        return pixels, irradiance

    def unoccluded(self, points: Floats, normals: Floats) -> tuple[Floats, Floats]:
        """Pixels and irradiance as of `direct`, for points with unit normals (3, n) that nothing occludes from the
        projector.
        """
        pixels, depths = self.projector.project(points)
        irradiance = np.zeros(points.shape[1])
        reached = np.flatnonzero(self.projector.optics.sees(pixels, SPILL_PX))
        to_projector = self.projector.centre[:, None] - points[:, reached]
        facing = np.sum(normals[:, reached] * to_projector, axis=0).clip(0.0)
        brightness = self.projector.optics.vignetting(pixels[:, reached], _VIGNETTING)
        irradiance[reached] = brightness * facing / depths[reached] ** 3
        return pixels, irradiance


class Lamp:
    """Light 1 + m cos(2πt + φ), with t in refresh periods. Every exposure begins at a random phase φ."""

    def __init__(self, settings: SimulatedRigSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng

    def brightness(self, exposure_us: float, rows: int) -> Light:
        """Brightness of the rows in the next frame, relative to the mean, (rows, 1)."""
        settings = self._settings
        if settings.pulsation == 0 and settings.flicker == 0:
            return np.ones((rows, 1), np.float32)
        # sinc is the mean of the cosine over an exposure of that many periods.
        periods = exposure_us / 1e6 * settings.refresh_hz
        swing = settings.pulsation * np.sinc(periods) + settings.flicker
        rolled = settings.rolling_shutter_ms / 1e3 * settings.refresh_hz
        phase = self._rng.uniform(0, 2 * np.pi) + 2 * np.pi * rolled * np.arange(rows) / rows
        return (1 + swing * np.cos(phase)).astype(np.float32)[:, None]
