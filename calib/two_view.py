"""What all planes of a still scene share, seen by two uncalibrated devices: lens distortion and epipolar geometry.

In ideal (undistorted) coordinates the homography of every plane is A + e vᵀ, with one 3 × 3 matrix A and the epipole e
for all planes and three numbers v for each (Hartley & Zisserman, 2nd ed., result 13.1). A single match on its own
gives its *parallax* ρ: projector ~ A x + ρ e. A plane is then what has ρ = v · x: an affine function of the image.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import Floats
from calib.homography import homogeneous

LENS_TERMS = 4
# Standard deviations of k1, k2 and the distortion's centre, for a unit of half the image's width: an ordinary lens in
# front of a sensor; a projector's lens is shifted up or down on purpose.
CAMERA_SIGMA = (0.06, 0.02, 0.06, 0.06)
PROJECTOR_SIGMA = (0.06, 0.02, 0.06, 0.3)


@dataclass(frozen=True)
class Lens:
    """Pixels → ideal coordinates. With p = (pixel − image centre) / half the image's width, and c the centre of the
    distortion in the same units: ideal = c + (p − c) (1 + k1 r² + k2 r⁴), r = |p − c|.

    This is the inverse of the usual model, so k1 has the opposite sign of the lens's own.
    """

    size_px: tuple[int, int]
    k1: float = 0.0
    k2: float = 0.0
    centre: tuple[float, float] = (0.0, 0.0)

    @property
    def unit_px(self) -> float:
        """Half the image's width."""
        return self.size_px[0] / 2

    def normalised(self, pixels: Floats) -> Floats:
        """(..., 2) → (..., 2): the coordinates p above."""
        width, height = self.size_px
        normalised: Floats = (pixels - ((width - 1) / 2, (height - 1) / 2)) / self.unit_px
        return normalised

    def ideal(self, pixels: Floats) -> Floats:
        """(..., 2) → (..., 2)."""
        offset = self.normalised(pixels) - self.centre
        r2 = np.sum(offset * offset, axis=-1, keepdims=True)
        ideal: Floats = offset * (1 + r2 * (self.k1 + r2 * self.k2)) + self.centre
        return ideal

    def jacobian(self, pixels: Floats) -> Floats:
        """Derivative of `ideal` with respect to `parameters`, (N, 2) → (N, 2, 4)."""
        offset = self.normalised(pixels) - self.centre
        r2 = np.sum(offset * offset, axis=-1)[:, None, None]
        column = offset[:, :, None]
        by_offset = (r2 * (self.k1 + r2 * self.k2)) * np.eye(2)
        by_offset = by_offset + 2 * (self.k1 + 2 * r2 * self.k2) * column * offset[:, None, :]
        return np.concatenate([column * r2, column * r2 * r2, -by_offset], axis=2)

    @property
    def parameters(self) -> Floats:
        """k1, k2, centre: (4,)."""
        return np.array([self.k1, self.k2, *self.centre])

    def with_parameters(self, values: Floats) -> "Lens":
        """The inverse of `parameters`."""
        k1, k2, x, y = map(float, values)
        return replace(self, k1=k1, k2=k2, centre=(x, y))


@dataclass(frozen=True)
class Parallax:
    """Per match: `x` (N, 3) ideal homogeneous camera point, `value` (N,) its ρ, `per_px` (N,) change of ρ with one
    projector pixel along the epipolar line, `across_px` (N,) distance from that line in projector pixels.
    """

    x: Floats
    value: Floats
    per_px: Floats
    across_px: Floats


@dataclass(frozen=True)
class TwoView:
    """`base` (3, 3) is A, `epipole` (3,) is e, both in ideal coordinates."""

    camera: Lens
    projector: Lens
    base: Floats
    epipole: Floats

    def homography(self, plane: Floats) -> Floats:
        """A + e vᵀ: planes (..., 3) → (..., 3, 3)."""
        return self.base + self.epipole[:, None] * plane[..., None, :]

    def parallax(self, camera_px: Floats, projector_px: Floats) -> Parallax:
        """Parallax of matches (N, 2), (N, 2), along the epipolar line through the point that A predicts."""
        x = homogeneous(self.camera.ideal(camera_px))
        u = self.projector.ideal(projector_px)
        base = x @ self.base.T
        # u ~ base + ρ e: two equations in ρ, ρ along = apart.
        along = self.epipole[:2] - u * self.epipole[2]
        apart = u * base[:, 2:] - base[:, :2]
        size2 = np.sum(along * along, axis=1)
        value = np.sum(along * apart, axis=1) / size2
        scale = np.abs(base[:, 2] + value * self.epipole[2]) / self.projector.unit_px
        across = (along[:, 0] * apart[:, 1] - along[:, 1] * apart[:, 0]) / np.sqrt(size2)
        return Parallax(x, value, scale / np.sqrt(size2), across / scale)
