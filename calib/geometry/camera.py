"""One camera model for both devices: a pinhole with square-ish pixels and Brown's lens distortion.

Pixel centres are at integer coordinates (OpenCV); x right, y down, z forward. A projector is a camera whose rays run
the other way.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial.polynomial import polyval

from calib.numerics import Bools, Floats

_NEWTON_STEPS = 30
_NEWTON_TOLERANCE = 1e-12
_WORTH_A_POLYNOMIAL = 1000
_DEGREES = (6, 10, 14, 18)
_CHECKED = 64
_POLYNOMIAL_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Intrinsics:
    """What one device does to a ray.

    `focal_px` is (f_x, f_y), `principal_point_px` is (x_0, y_0), `distortion` is (k1, k2, p1, p2, k3) in normalised
    coordinates, in OpenCV's order: x_d = x_n (1 + k1 r² + k2 r⁴ + k3 r⁶) + tangential terms.
    """

    width: int
    height: int
    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (self.width > 0 and self.height > 0):
            raise ValueError(f"an image needs a size, found {self.width} × {self.height}")
        numbers = (*self.focal_px, *self.principal_point_px, *self.distortion)
        if not np.all(np.isfinite(numbers)):
            raise ValueError(f"intrinsics must be finite numbers, found {numbers}")
        if not min(self.focal_px) > 0:
            raise ValueError(f"focal lengths must be positive, found {self.focal_px}")

    @property
    def matrix(self) -> Floats:
        """K, (3, 3)."""
        (fx, fy), (x0, y0) = self.focal_px, self.principal_point_px
        return np.array([[fx, 0.0, x0], [0.0, fy, y0], [0.0, 0.0, 1.0]])

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
        distorted = (pixels - np.array(self.principal_point_px)) / np.array(self.focal_px)
        normalised = self.undistort(distorted)
        return np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)

    def distort(self, normalised: Floats) -> Floats:
        """Brown (1971), as in OpenCV: ideal (..., 2) → distorted (..., 2), both in normalised coordinates."""
        if not any(self.distortion):
            return normalised.copy("K")
        k1, k2, p1, p2, k3 = self.distortion
        x, y = normalised[..., 0], normalised[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        # In the memory layout of the argument: where columns lie together, arithmetic is several times as fast.
        distorted = np.empty_like(normalised)
        np.multiply(x, radial, out=distorted[..., 0])
        np.multiply(y, radial, out=distorted[..., 1])
        if p1 or p2:
            distorted[..., 0] += 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
            distorted[..., 1] += p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return distorted

    def undistort(self, distorted: Floats) -> Floats:
        """Inverse of `distort`; NaN where it has none within the lens's monotonic range."""
        if not any(self.distortion):
            return distorted.copy("K")
        inverse = self.inverse_for(distorted.size // 2)
        if inverse is None:
            return self._undistort_by_newton(distorted)
        polynomial, largest = inverse
        r2 = distorted[..., 0] * distorted[..., 0] + distorted[..., 1] * distorted[..., 1]
        if not np.max(r2) <= largest:
            return self._undistort_by_newton(distorted)
        normalised: Floats = distorted * polyval(r2, polynomial)[..., None]
        return normalised

    def inverse_for(self, count: int) -> tuple[Floats, float] | None:
        """The inverse of `distort` as a polynomial: ideal over distorted radius by the distorted radius squared.

        Its coefficients from the constant upwards, and the radius squared up to which it holds. None where there is
        none as good as Newton's method, or where it is not worth finding it for so few points.
        """
        if not any(self.distortion):
            return np.ones(1), np.inf
        return self._radial_inverse if count >= _WORTH_A_POLYNOMIAL else None

    @cached_property
    def _radial_inverse(self) -> tuple[Floats, float] | None:
        """Ideal over distorted radius as a polynomial in the distorted radius squared, and up to where it holds: over
        the whole image. None where there is none as good as Newton's method.
        """
        if any(self.distortion[2:4]):
            return None
        corners = np.array([(x, y) for x in (-1, self.width) for y in (-1, self.height)], np.float64)
        corners = (corners - np.array(self.principal_point_px)) / np.array(self.focal_px)
        largest = float(np.max(np.sum(corners * corners, axis=1)))

        def ratio(r2: Floats) -> Floats:
            along = np.stack([np.sqrt(r2), np.zeros_like(r2)], axis=-1)
            ideal: Floats = self._undistort_by_newton(along)[..., 0] / along[..., 0]
            return ideal

        between = np.linspace(1e-6, 1, _CHECKED) * largest
        exact = ratio(between)
        for degree in _DEGREES:
            fitted = Chebyshev.interpolate(ratio, degree, (0.0, largest)).convert(kind=Polynomial, domain=(-1, 1))
            # NaN, beyond which the lens has no inverse, is no small difference either.
            if np.max(np.abs(polyval(between, fitted.coef) - exact)) < _POLYNOMIAL_TOLERANCE:
                return np.asarray(fitted.coef, np.float64), largest
        return None

    def _undistort_by_newton(self, distorted: Floats) -> Floats:
        normalised = distorted.copy("K")
        for _ in range(_NEWTON_STEPS):
            error = self.distort(normalised) - distorted
            (a, b), (c, d) = self._distortion_jacobian(normalised)
            determinant = a * d - b * c
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.stack(
                    [
                        (d * error[..., 0] - b * error[..., 1]) / determinant,
                        (a * error[..., 1] - c * error[..., 0]) / determinant,
                    ],
                    axis=-1,
                )
            normalised = normalised - step
            if not np.nanmax(np.abs(step), initial=0.0) > _NEWTON_TOLERANCE:
                break
        return np.where(self._inverted(normalised, distorted)[..., None], normalised, np.nan)

    def _inverted(self, normalised: Floats, distorted: Floats) -> Bools:
        with np.errstate(invalid="ignore"):
            residual = np.abs(self.distort(normalised) - distorted).max(axis=-1)
            (a, b), (c, d) = self._distortion_jacobian(normalised)
            inverted: Bools = (residual < 1e-9) & (a * d - b * c > 0) & (a + d > 0)
        return inverted

    def _distortion_jacobian(self, normalised: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        k1, k2, p1, p2, k3 = self.distortion
        x, y = normalised[..., 0], normalised[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        cross = slope * x * y + 2 * p1 * x + 2 * p2 * y
        return (
            (radial + slope * x * x + 2 * p1 * y + 6 * p2 * x, cross),
            (cross, radial + slope * y * y + 6 * p1 * y + 2 * p2 * x),
        )
