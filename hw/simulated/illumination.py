"""Direct illumination: the projector's light on its way from the lens to a surface."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats, Ints
from hw.simulated.device import PlacedDevice
from hw.simulated.scene import Scene

_VIGNETTING = 0.25
# Light of the outermost pixels spills this far beyond the picture's edge by blur, which is 4 pixels at most.
SPILL_PX = 10.0


@dataclass(frozen=True)
class ProjectorLight:
    """Light of a projector in a scene, in units in which a picture of ones lights a screen at 1 m on the axis by 1."""

    scene: Scene
    projector: PlacedDevice

    def direct(self, surface: Ints, points: Floats) -> tuple[Floats, Floats]:
        """The projector's pixels (2, n) for points (3, n) on surfaces (n,), and the irradiance (n,) per unit of it.

        It is zero where the surface faces away, lies outside the picture or is in shadow. A projector
        spreads each pixel's power over the pixel's solid angle, and equal pixels on a plane have solid angles that
        fall with cos³ of the angle to the axis; hence the irradiance (n · s) / z³, with s the vector to the projector
        and z the depth along its axis, times vignetting.
        """
        pixels, irradiance = self.unhidden(points, self.scene.normals(surface, points))
        reached = np.flatnonzero(irradiance)
        irradiance[reached[self.scene.occluded(points[:, reached], self.projector.centre)]] = 0.0
        return pixels, irradiance

    def unhidden(self, points: Floats, normals: Floats) -> tuple[Floats, Floats]:
        """The same for points with unit normals (3, n) from which nothing hides the projector."""
        pixels, depths = self.projector.project(points)
        irradiance = np.zeros(points.shape[1])
        reached = np.flatnonzero(self.projector.optics.sees(pixels, SPILL_PX))
        to_projector = self.projector.centre[:, None] - points[:, reached]
        facing = np.sum(normals[:, reached] * to_projector, axis=0).clip(0.0)
        brightness = self.projector.optics.vignetting(pixels[:, reached], _VIGNETTING)
        irradiance[reached] = brightness * facing / depths[reached] ** 3
        return pixels, irradiance
