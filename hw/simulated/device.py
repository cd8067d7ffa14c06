"""A device in the room: a pinhole with radial lens distortion, used for the camera and the projector alike.

It does not use the calibration's camera model, so that an error in either shows.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib.geometry import Pose
from calib.numerics import Bools, Floats

_KNOTS = 4096
_MARGIN = 1.5  # multiple of the image's half diagonal to which the lens is modelled


@dataclass(frozen=True)
class Optics:
    """x_pixel = principal point + focal · x (1 + k1 r² + k2 r⁴), with x = X/Z; pixel centres at integers."""

    width: int
    height: int
    focal_px: float
    principal_point_px: tuple[float, float]
    k1: float = 0.0
    k2: float = 0.0

    @cached_property
    def corner_radius(self) -> float:
        """Distance of the farthest pixel from the principal point, over the focal length."""
        x0, y0 = self.principal_point_px
        farthest = np.hypot(max(x0, self.width - 1 - x0), max(y0, self.height - 1 - y0))
        return float(farthest / self.focal_px)

    def to_pixels(self, x: Floats, y: Floats) -> Floats:
        """Ideal image coordinates X/Z, Y/Z (n,) → pixels (2, n); NaN far outside the image."""
        r2 = x * x + y * y
        scale = np.where(r2 < (_MARGIN * self.corner_radius) ** 2, 1 + r2 * (self.k1 + r2 * self.k2), np.nan)
        x0, y0 = self.principal_point_px
        return np.stack([x0 + self.focal_px * scale * x, y0 + self.focal_px * scale * y])

    def to_rays(self, pixels: Floats) -> Floats:
        """Pixels (2, n) → directions (3, n) with z = 1 in the device's frame."""
        x0, y0 = self.principal_point_px
        x = (pixels[0] - x0) / self.focal_px
        y = (pixels[1] - y0) / self.focal_px
        if self.k1 or self.k2:
            scale = np.interp(x * x + y * y, *self._inverse_lens)
            x, y = x * scale, y * scale
        return np.stack([x, y, np.ones_like(x)])

    def sees(self, pixels: Floats, margin_px: float = 0.0) -> Bools:
        """Whether pixels (2, n) are within the outer edges of the image, enlarged by a margin."""
        reach = 0.5 + margin_px
        x, y = pixels
        with np.errstate(invalid="ignore"):
            inside: Bools = (
                (x >= -reach) & (x <= self.width - 1 + reach) & (y >= -reach) & (y <= self.height - 1 + reach)
            )
        return inside

    def vignetting(self, pixels: Floats, loss: float) -> Floats:
        """Relative brightness (n,) at pixels (2, n): 1 on the axis, decreasing with r² by `loss` at the farthest
        corner.
        """
        x0, y0 = self.principal_point_px
        r2 = ((pixels[0] - x0) ** 2 + (pixels[1] - y0) ** 2) / self.focal_px**2
        brightness: Floats = 1.0 - loss * r2 / self.corner_radius**2
        return brightness

    @cached_property
    def _inverse_lens(self) -> tuple[Floats, Floats]:
        """Squared distorted radius and ideal / distorted radius, as a table. Interpolation errs by about 1e-9."""
        r2 = np.linspace(0.0, (_MARGIN * self.corner_radius) ** 2, _KNOTS)
        scale = 1 + r2 * (self.k1 + r2 * self.k2)
        return r2 * scale**2, 1 / scale


@dataclass(frozen=True)
class PlacedDevice:
    """Optics with a pose: X_device = rotation (X_world − centre); `rotation` (3, 3), `centre` (3,) in metres."""

    optics: Optics
    rotation: Floats
    centre: Floats

    @property
    def pose(self) -> Pose:
        """X_world = R X_device + t, in metres."""
        return Pose(self.rotation.T, self.centre)

    def rays(self, pixels: Floats) -> Floats:
        """Pixels (2, n) → directions (3, n) in the world, of length 1 along the optical axis."""
        return self.rotation.T @ self.optics.to_rays(pixels)

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Points (3, n) of the world → pixels (2, n), NaN behind the device, and depths along the axis (n,)."""
        x, y, z = self.rotation @ (points - self.centre[:, None])
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(z > 0, z, np.nan)
            return self.optics.to_pixels(x / ahead, y / ahead), z
