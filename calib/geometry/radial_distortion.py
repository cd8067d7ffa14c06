"""Lens distortion: Brown's model with its inverse and exact derivatives. This is the only place with the formula.

A lens moves the ideal image point x, in units of the focal length, to x (1 + k1 r² + k2 r⁴ + k3 r⁶) + tangential terms
in p1, p2, with r = |x| (Brown 1971; signs and order k1, k2, p1, p2, k3 as in OpenCV).

Devices are (8,): f, x_0, y_0, k1, k2, p1, p2, k3; or (9,), with f_y / f_x after f, whose column is its logarithm.
"""

import numpy as np

from calib.numerics import Floats, by_columns, compiled, inlined

PER_DEVICE = 8

_NEWTON_STEPS = 30
# Largest last step (the error after it is about its square), and largest error of an accepted inverse.
_CONVERGED, _INVERTED = 1e-6, 1e-9

Distortion = tuple[float, float, float, float, float]
Pinhole = tuple[float, float, float, float]


def distort(ideal: Floats, distortion: Distortion) -> Floats:
    """Ideal (..., 2) → distorted (..., 2), both in normalised coordinates."""
    columns = by_columns(ideal.reshape(-1, 2)).T
    distorted = np.empty_like(columns)
    _distort(columns, distortion, distorted)
    return distorted.T.reshape(ideal.shape)


def undistort(
    distorted: Floats,
    distortion: Distortion,
    pinhole: Pinhole = (1.0, 1.0, 0.0, 0.0),
    *,
    converged: float = _CONVERGED,
) -> Floats:
    """Inverse of `distort` by Newton's method, (..., 2); NaN where it has none within the lens's monotonic range.

    With a `pinhole`, focal lengths and principal point, it takes pixels. `converged`: largest last step.
    """
    columns = by_columns(distorted.reshape(-1, 2)).T
    ideal = np.empty_like(columns)
    _undistort(columns, distortion, pinhole, converged, ideal)
    return ideal.T.reshape(distorted.shape)


def distort_steps(ideal: Floats, steps: Floats, distortion: Distortion) -> tuple[Floats, Floats]:
    """Distorted points (2, N), and their displacements for `steps` (2, N) of the ideal points (2, N)."""
    if not any(distortion):
        return ideal, steps
    distorted, moved = np.empty_like(ideal), np.empty_like(ideal)
    _distort_steps(ideal, steps, distortion, distorted, moved)
    return distorted, moved


def unproject(device: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    """Rays (N, 3) at z = 1 and their derivatives (N, 3, 8) by log f, x_0, y_0, k1, k2, p1, p2, k3, or (N, 3, 9)."""
    rays, by_device = np.empty((len(pixels), 3)), np.zeros((len(pixels), 3, len(device)))
    unproject_into(device, np.ascontiguousarray(pixels, np.float64), rays, by_device)
    return rays, by_device


def project(device: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Pixels (N, 2), their derivatives (N, 2, 3) by the point and (N, 2, 8 or 9) by the device, as in `unproject`."""
    count = len(points)
    pixels, by_point, by_device = np.empty((count, 2)), np.empty((count, 2, 3)), np.zeros((count, 2, len(device)))
    project_into(device, np.ascontiguousarray(points, np.float64), pixels, by_point, by_device)
    return pixels, by_point, by_device


def rescaled(pixels: Floats, origin_px: tuple[float, float], per_px: float, lens: Floats) -> Floats:
    """c + q (1 + k1 |q|² + k2 |q|⁴) with q = (pixel − origin) per_px − c, (..., 2); `lens`: k1, k2, c (4,)."""
    moved = np.empty(pixels.shape)
    _rescale(np.ascontiguousarray(pixels).reshape(-1, 2), *origin_px, per_px, lens, moved.reshape(-1, 2))
    return moved


def rescaled_by_lens(pixels: Floats, origin_px: tuple[float, float], per_px: float, lens: Floats) -> Floats:
    """Derivatives of `rescaled` by the lens, (N, 2) → (N, 2, 4)."""
    jacobian = np.empty((len(pixels), 2, 4))
    _rescale_by_lens(pixels, *origin_px, per_px, lens, jacobian)
    return jacobian


@inlined
def _radial(r2: float, k1: float, k2: float, k3: float) -> tuple[float, float]:
    """Distorted over ideal radius, and twice its derivative by r²."""
    return 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))


@inlined
def distorted_point(x: float, y: float, distortion: Distortion) -> tuple[float, float, float, float, float]:
    """The distorted point, and its Jacobian [[a, b], [b, d]] by the ideal one."""
    k1, k2, p1, p2, k3 = distortion
    r2 = x * x + y * y
    radial, slope = _radial(r2, k1, k2, k3)
    u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    v = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)
    a = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
    d = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
    return u, v, a, slope * x * y + 2.0 * (p1 * x + p2 * y), d


@inlined
def _newton_step(x: float, y: float, u: float, v: float, distortion: Distortion) -> tuple[float, float, float, bool]:
    """A step of Newton's method towards the ideal point of the distorted one (u, v), how far it moved, and whether it
    began where the lens is monotonic.
    """
    bent_x, bent_y, a, b, d = distorted_point(x, y, distortion)
    off_x, off_y, determinant = bent_x - u, bent_y - v, a * d - b * b
    inverse = 1.0 / determinant
    step_x, step_y = (d * off_x - b * off_y) * inverse, (a * off_y - b * off_x) * inverse
    return x - step_x, y - step_y, abs(step_x) + abs(step_y), (determinant > 0.0) & (a + d > 0.0)


@inlined
def _ideal(u: float, v: float, distortion: Distortion) -> tuple[float, float]:
    """Newton's method from the distorted point; the result is arbitrary where it does not converge."""
    x, y = u, v
    for _ in range(_NEWTON_STEPS):
        x, y, step, _ = _newton_step(x, y, u, v, distortion)
        if not step > _CONVERGED:
            break
    return x, y


@compiled
def _distort(ideal: Floats, distortion: Distortion, distorted: Floats) -> None:
    for i in range(ideal.shape[1]):
        distorted[0, i], distorted[1, i], _, _, _ = distorted_point(ideal[0, i], ideal[1, i], distortion)


@compiled
def _undistort(distorted: Floats, distortion: Distortion, pinhole: Pinhole, converged: float, ideal: Floats) -> None:
    # Rows are taken out of the arrays before the loop: columns indexed inside it kept the compiler from vectorising.
    # All points take a step before any takes the next, for the same reason.
    u, v, x, y = distorted[0], distorted[1], ideal[0], ideal[1]
    x_scale, y_scale, x_0, y_0 = 1.0 / pinhole[0], 1.0 / pinhole[1], pinhole[2], pinhole[3]
    for i in range(len(x)):
        x[i], y[i] = (u[i] - x_0) * x_scale, (v[i] - y_0) * y_scale
    for _ in range(_NEWTON_STEPS):
        moving, outside = 0, 0
        for i in range(len(x)):
            bent_x, bent_y = (u[i] - x_0) * x_scale, (v[i] - y_0) * y_scale
            x[i], y[i], step, monotonic = _newton_step(x[i], y[i], bent_x, bent_y, distortion)
            moving += step > converged
            outside += not monotonic
        if moving + outside == 0:
            return
        if moving == 0:
            break
    for i in range(len(x)):
        bent_x, bent_y, a, b, d = distorted_point(x[i], y[i], distortion)
        off = max(abs(bent_x - (u[i] - x_0) * x_scale), abs(bent_y - (v[i] - y_0) * y_scale))
        inverted = (off < _INVERTED) & (a * d - b * b > 0.0) & (a + d > 0.0)
        x[i], y[i] = x[i] if inverted else np.nan, y[i] if inverted else np.nan


@compiled
def _distort_steps(ideal: Floats, steps: Floats, distortion: Distortion, distorted: Floats, moved: Floats) -> None:
    x, y, step_x, step_y = ideal[0], ideal[1], steps[0], steps[1]
    distorted_x, distorted_y, moved_x, moved_y = distorted[0], distorted[1], moved[0], moved[1]
    for i in range(len(x)):
        u, v, a, b, d = distorted_point(x[i], y[i], distortion)
        distorted_x[i], distorted_y[i] = u, v
        moved_x[i], moved_y[i] = a * step_x[i] + b * step_y[i], b * step_x[i] + d * step_y[i]


@compiled
def unproject_into(device: Floats, pixels: Floats, rays: Floats, by_device: Floats) -> None:
    """`unproject`, into empty `rays` and zeros."""
    after = len(device) - PER_DEVICE  # the column after that of f, or of the aspect
    focal, focal_y = device[0], device[0] * device[1] if after else device[0]
    x_0, y_0, k1, k2, p1, p2, k3 = device[1 + after :]
    by_rest = by_device[:, :, 1 + after :]
    for i in range(len(pixels)):
        # Distorted, in units of the focal length: u = (pixel − centre) / f.
        u, v = (pixels[i, 0] - x_0) / focal, (pixels[i, 1] - y_0) / focal_y
        x, y = _ideal(u, v, (k1, k2, p1, p2, k3))
        rays[i, 0], rays[i, 1], rays[i, 2] = x, y, 1.0

        # J dx = du − (∂ distorted / ∂k) dk
        r2 = x * x + y * y
        _, _, a, b, d = distorted_point(x, y, (k1, k2, p1, p2, k3))
        inverse = 1.0 / (a * d - b * b)
        by_device[i, 0, 0], by_device[i, 1, 0] = (b * v - d * u) * inverse, (b * u - a * v) * inverse
        for column, du, dv in (
            (0, -1 / focal, 0.0),
            (1, 0.0, -1 / focal_y),
            (2, -x * r2, -y * r2),
            (3, -x * r2 * r2, -y * r2 * r2),
            (4, -2.0 * x * y, -(r2 + 2.0 * y * y)),
            (5, -(r2 + 2.0 * x * x), -2.0 * x * y),
            (6, -x * r2 * r2 * r2, -y * r2 * r2 * r2),
        ):
            by_rest[i, 0, column] = (d * du - b * dv) * inverse
            by_rest[i, 1, column] = (a * dv - b * du) * inverse
        if after:  # a longer f_y moves the point as a lower centre does
            for k in range(2):
                by_device[i, k, 1] = by_rest[i, k, 1] * (pixels[i, 1] - y_0)


@compiled
def project_into(device: Floats, points: Floats, pixels: Floats, by_point: Floats, by_device: Floats) -> None:
    """`project`, into empty `pixels` and `by_point`, and zeros."""
    after = len(device) - PER_DEVICE
    focal, focal_y = device[0], device[0] * device[1] if after else device[0]
    x_0, y_0, k1, k2, p1, p2, k3 = device[1 + after :]
    for i in range(len(points)):
        z = points[i, 2]
        x, y = points[i, 0] / z, points[i, 1] / z
        r2 = x * x + y * y
        u, v, a, b, d = distorted_point(x, y, (k1, k2, p1, p2, k3))
        pixels[i, 0], pixels[i, 1] = focal * u + x_0, focal_y * v + y_0
        # dx = (dX − x dZ) / Z
        across, down = focal / z, focal_y / z
        by_point[i, 0, 0], by_point[i, 0, 1], by_point[i, 0, 2] = across * a, across * b, -across * (a * x + b * y)
        by_point[i, 1, 0], by_point[i, 1, 1], by_point[i, 1, 2] = down * b, down * d, -down * (b * x + d * y)
        by_device[i, 0, 0], by_device[i, 1, 0] = focal * u, focal_y * v
        if after:
            by_device[i, 1, 1] = focal_y * v
        by_x, by_y = by_device[i, 0, 1 + after :], by_device[i, 1, 1 + after :]
        by_x[0], by_y[1] = 1.0, 1.0
        by_x[2], by_y[2] = focal * x * r2, focal_y * y * r2
        by_x[3], by_y[3] = focal * x * r2 * r2, focal_y * y * r2 * r2
        by_x[4], by_y[4] = focal * 2.0 * x * y, focal_y * (r2 + 2.0 * y * y)
        by_x[5], by_y[5] = focal * (r2 + 2.0 * x * x), focal_y * 2.0 * x * y
        by_x[6], by_y[6] = focal * x * r2 * r2 * r2, focal_y * y * r2 * r2 * r2


@inlined
def rescaled_point(x: float, y: float, x0: float, y0: float, per_px: float, lens: Floats) -> tuple[float, float]:
    """`rescaled` of one pixel."""
    k1, k2, x_c, y_c = lens[0], lens[1], lens[2], lens[3]
    x, y = (x - x0) * per_px - x_c, (y - y0) * per_px - y_c
    ratio, _ = _radial(x * x + y * y, k1, k2, 0.0)
    return x * ratio + x_c, y * ratio + y_c


@compiled
def _rescale(pixels: Floats, x0: float, y0: float, per_px: float, lens: Floats, moved: Floats) -> None:
    for i in range(len(pixels)):
        moved[i, 0], moved[i, 1] = rescaled_point(pixels[i, 0], pixels[i, 1], x0, y0, per_px, lens)


@compiled
def _rescale_by_lens(pixels: Floats, x0: float, y0: float, per_px: float, lens: Floats, jacobian: Floats) -> None:
    k1, k2, x_c, y_c = lens[0], lens[1], lens[2], lens[3]
    for i in range(len(pixels)):
        x, y = (pixels[i, 0] - x0) * per_px - x_c, (pixels[i, 1] - y0) * per_px - y_c
        r2 = x * x + y * y
        ratio, slope = _radial(r2, k1, k2, 0.0)
        jacobian[i, 0, 0], jacobian[i, 0, 1] = x * r2, x * r2 * r2
        jacobian[i, 1, 0], jacobian[i, 1, 1] = y * r2, y * r2 * r2
        jacobian[i, 0, 2], jacobian[i, 0, 3] = 1.0 - ratio - slope * x * x, -slope * x * y
        jacobian[i, 1, 2], jacobian[i, 1, 3] = -slope * x * y, 1.0 - ratio - slope * y * y
