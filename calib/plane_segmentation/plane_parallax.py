"""Plane plus parallax: the lens distortion and epipolar geometry that all planes of a static scene share.

In ideal (undistorted) coordinates the homography of every plane is A + e vᵀ, with one 3 × 3 matrix A and the epipole e
for all planes and three numbers v for each (Hartley & Zisserman, 2nd ed., result 13.1). A single match on its own
gives its *parallax* ρ: projector ~ A x + ρ e. A plane is then what has ρ = v · x: an affine function of the image.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.geometry import homogeneous, rescaled, rescaled_by_lens
from calib.numerics import Floats, compiled

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

    @property
    def centre_px(self) -> tuple[float, float]:
        """The image's centre."""
        return (self.size_px[0] - 1) / 2, (self.size_px[1] - 1) / 2

    def ideal(self, pixels: Floats) -> Floats:
        """(..., 2) → (..., 2)."""
        return rescaled(pixels, self.centre_px, 1 / self.unit_px, self.parameters)

    def jacobian(self, pixels: Floats) -> Floats:
        """Derivative of `ideal` with respect to `parameters`, (N, 2) → (N, 2, 4)."""
        return rescaled_by_lens(pixels, self.centre_px, 1 / self.unit_px, self.parameters)

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
    """Parallax of each match."""

    x: Floats
    """Ideal homogeneous camera point, (N, 3)."""
    value: Floats
    """Its ρ, (N,)."""
    per_px: Floats
    """Change of ρ with one projector pixel along the epipolar line, (N,)."""
    across_px: Floats
    """Distance from that line in projector pixels, (N,)."""


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
        value, per_px, across_px = np.empty((3, len(x)))
        _parallax(
            x,
            self.projector.ideal(projector_px),
            np.ascontiguousarray(self.base),
            np.ascontiguousarray(self.epipole),
            self.projector.unit_px,
            value,
            per_px,
            across_px,
        )
        return Parallax(x, value, per_px, across_px)


@compiled
def _parallax(
    x: Floats,
    u: Floats,
    base: Floats,
    epipole: Floats,
    unit_px: float,
    value: Floats,
    per_px: Floats,
    across_px: Floats,
) -> None:
    """Of ideal points x (N, 3) and u (N, 2): u ~ base x + ρ e gives two equations in ρ, ρ along = apart."""
    for i in range(len(x)):
        x0, x1, u0, u1 = x[i, 0], x[i, 1], u[i, 0], u[i, 1]
        third = base[2, 0] * x0 + base[2, 1] * x1 + base[2, 2]
        along0, along1 = epipole[0] - u0 * epipole[2], epipole[1] - u1 * epipole[2]
        apart0 = u0 * third - (base[0, 0] * x0 + base[0, 1] * x1 + base[0, 2])
        apart1 = u1 * third - (base[1, 0] * x0 + base[1, 1] * x1 + base[1, 2])
        size2 = along0 * along0 + along1 * along1
        size = np.sqrt(size2)
        value[i] = (along0 * apart0 + along1 * apart1) / size2
        scale = np.abs(third + value[i] * epipole[2]) / unit_px
        per_px[i] = scale / size
        across_px[i] = (along0 * apart1 - along1 * apart0) / size / scale
