"""What a lens with two radial terms does to pixels and to points, with the exact derivatives that the model needs.

A device is (5,): f, x_0, y_0, k1, k2. A lens moves the ideal image point x, in units of the focal length, to
x (1 + k1 r² + k2 r⁴) with r = |x|.
"""

import numpy as np

from calib.numerics import Floats, compiled

_UNDISTORT_STEPS = 12
_UNDISTORTED = 1e-13


def unproject(device: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    """Rays (N, 3) at z = 1 and their derivatives (N, 3, 5) by log f, x_0, y_0, k1, k2."""
    rays, by_device = np.empty((len(pixels), 3)), np.zeros((len(pixels), 3, 5))
    _unproject(device, np.ascontiguousarray(pixels, np.float64), rays, by_device)
    return rays, by_device


def project(device: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Pixels (N, 2), their derivatives (N, 2, 3) by the point and (N, 2, 5) by log f, x_0, y_0, k1, k2."""
    count = len(points)
    pixels, by_point, by_device = np.empty((count, 2)), np.empty((count, 2, 3)), np.zeros((count, 2, 5))
    _project(device, np.ascontiguousarray(points, np.float64), pixels, by_point, by_device)
    return pixels, by_point, by_device


@compiled
def _unproject(device: Floats, pixels: Floats, rays: Floats, by_device: Floats) -> None:
    focal, x_0, y_0, k1, k2 = device
    for i in range(len(pixels)):
        # Distorted, in units of the focal length: u = (pixel − centre) / f.
        u, v = (pixels[i, 0] - x_0) / focal, (pixels[i, 1] - y_0) / focal
        ratio = _ideal_over_distorted(np.sqrt(u * u + v * v), k1, k2)
        x, y = ratio * u, ratio * v
        rays[i, 0], rays[i, 1], rays[i, 2] = x, y, 1.0

        # J dx = du − (∂ distorted / ∂k) dk
        r2, _, a, b, d = _distortion(x, y, k1, k2)
        determinant = a * d - b * b
        for column, du, dv in (
            (0, -u, -v),
            (1, -1 / focal, 0.0),
            (2, 0.0, -1 / focal),
            (3, -x * r2, -y * r2),
            (4, -x * r2 * r2, -y * r2 * r2),
        ):
            by_device[i, 0, column] = (d * du - b * dv) / determinant
            by_device[i, 1, column] = (a * dv - b * du) / determinant


@compiled
def _project(device: Floats, points: Floats, pixels: Floats, by_point: Floats, by_device: Floats) -> None:
    focal, x_0, y_0, k1, k2 = device
    for i in range(len(points)):
        z = points[i, 2]
        x, y = points[i, 0] / z, points[i, 1] / z
        r2, factor, a, b, d = _distortion(x, y, k1, k2)
        u, v = factor * x, factor * y
        pixels[i, 0], pixels[i, 1] = focal * u + x_0, focal * v + y_0
        # dx = (dX − x dZ) / Z
        scale = focal / z
        by_point[i, 0, 0], by_point[i, 0, 1], by_point[i, 0, 2] = scale * a, scale * b, -scale * (a * x + b * y)
        by_point[i, 1, 0], by_point[i, 1, 1], by_point[i, 1, 2] = scale * b, scale * d, -scale * (b * x + d * y)
        by_device[i, 0, 0], by_device[i, 1, 0] = focal * u, focal * v
        by_device[i, 0, 1], by_device[i, 1, 2] = 1.0, 1.0
        by_device[i, 0, 3], by_device[i, 1, 3] = focal * x * r2, focal * y * r2
        by_device[i, 0, 4], by_device[i, 1, 4] = focal * x * r2 * r2, focal * y * r2 * r2


@compiled
def _distortion(x: float, y: float, k1: float, k2: float) -> tuple[float, float, float, float, float]:
    """r², distorted over ideal radius, and the Jacobian [[a, b], [b, d]] of the distorted point by the ideal one."""
    r2 = x * x + y * y
    factor = 1 + r2 * (k1 + r2 * k2)
    slope = 2 * (k1 + 2 * k2 * r2)
    return r2, factor, factor + slope * x * x, slope * x * y, factor + slope * y * y


@compiled
def _ideal_over_distorted(distorted: float, k1: float, k2: float) -> float:
    """r / r_d by Newton's method on r (1 + k1 r² + k2 r⁴) = r_d."""
    ideal = distorted
    for _ in range(_UNDISTORT_STEPS):
        r2 = ideal * ideal
        step = (ideal * (1 + r2 * (k1 + r2 * k2)) - distorted) / (1 + r2 * (3 * k1 + 5 * r2 * k2))
        ideal -= step
        if abs(step) < _UNDISTORTED:
            break
    return ideal / distorted if distorted > 0 else 1.0
