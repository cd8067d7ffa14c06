"""One camera model for both devices: a pinhole with square-ish pixels and Brown's lens distortion.

Pixel centres are at integer coordinates (OpenCV); x right, y down, z forward. A projector is modelled as an inverse
camera.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.geometry import radial_distortion as lens
from calib.numerics import Floats, Image


class Size(NamedTuple):
    """Size of an image, or of a device's image, in pixels."""

    width: int
    height: int

    @classmethod
    def of(cls, image: Image) -> "Size":
        """Of an image (H, W) or (H, W, 3)."""
        return cls(image.shape[1], image.shape[0])

    @property
    def pixels(self) -> Floats:
        """The centres of all pixels, (H, W, 2)."""
        return np.stack(np.meshgrid(np.arange(self.width, dtype=np.float64), np.arange(self.height)), axis=-1)

    def __str__(self) -> str:
        return f"{self.width} × {self.height}"


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsic parameters of one device."""

    width: int
    height: int
    focal_px: tuple[float, float]
    """(f_x, f_y)."""
    principal_point_px: tuple[float, float]
    """(x_0, y_0)."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """(k1, k2, p1, p2, k3) in normalised coordinates, in OpenCV's order: x_d = x_n (1 + k1 r² + k2 r⁴ + k3 r⁶) +
    tangential terms.
    """

    def __post_init__(self) -> None:
        if not (self.width > 0 and self.height > 0):
            raise ValueError(f"an image needs a size, found {self.width} × {self.height}")
        numbers = (*self.focal_px, *self.principal_point_px, *self.distortion)
        if not np.all(np.isfinite(numbers)):
            raise ValueError(f"intrinsics must be finite numbers, found {numbers}")
        if not min(self.focal_px) > 0:
            raise ValueError(f"focal lengths must be positive, found {self.focal_px}")

    @classmethod
    def of_device(cls, device: Floats, size: tuple[int, int]) -> "Intrinsics":
        """From the columns of a device, (8,) or (9,) as in `radial_distortion`, and its size (width, height)."""
        focal, *aspect, x0, y0, k1, k2, p1, p2, k3 = device.tolist()
        return cls(*size, (focal, focal * aspect[0] if aspect else focal), (x0, y0), (k1, k2, p1, p2, k3))

    @property
    def size(self) -> Size:
        """Of the device's image."""
        return Size(self.width, self.height)

    @property
    def matrix(self) -> Floats:
        """K, (3, 3)."""
        (fx, fy), (x0, y0) = self.focal_px, self.principal_point_px
        return np.array([[fx, 0.0, x0], [0.0, fy, y0], [0.0, 0.0, 1.0]])

    @property
    def pinhole(self) -> lens.Pinhole:
        """Focal lengths and principal point."""
        return *self.focal_px, *self.principal_point_px

    def project(self, points: Floats) -> Floats:
        """Points (..., 3) in the device's frame → pixels (..., 2); NaN for points not in front of the device."""
        z = points[..., 2:3]
        with np.errstate(divide="ignore", invalid="ignore"):
            normalised = np.where(z > 0, points[..., :2] / z, np.nan)
        pixels = self.distort(normalised)
        pixels *= np.array(self.focal_px)
        pixels += np.array(self.principal_point_px)
        return pixels

    def unproject(self, pixels: Floats) -> Floats:
        """Pixels (..., 2) → points (..., 3) on their rays at z = 1; NaN where the lens model has no inverse."""
        normalised = self.ideal(pixels)
        return np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)

    def ideal(self, pixels: Floats) -> Floats:
        """Pixels (..., 2) → where their rays meet z = 1, (..., 2); NaN where the lens model has no inverse."""
        return lens.undistort(pixels, self.distortion, self.pinhole)

    def distort(self, normalised: Floats) -> Floats:
        """Brown (1971), as in OpenCV: ideal (..., 2) → distorted (..., 2), both in normalised coordinates."""
        return lens.distort(normalised, self.distortion) if any(self.distortion) else normalised.copy("K")

    def undistort(self, distorted: Floats) -> Floats:
        """Inverse of `distort`; NaN where it has none within the lens's monotonic range."""
        return lens.undistort(distorted, self.distortion) if any(self.distortion) else distorted.copy("K")
