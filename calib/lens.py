"""What a lens with two radial terms does to pixels and to points, with the exact derivatives that the model needs.

A device is (5,): f, x_0, y_0, k1, k2.
"""

import numpy as np

from calib.arrays import Floats

_UNDISTORT_STEPS = 12


def unproject(device: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    """Rays (N, 3) at z = 1 and their derivatives (N, 3, 5) by log f, x_0, y_0, k1, k2."""
    focal, centre, k = device[0], device[1:3], device[3:]
    distorted = (pixels - centre) / focal
    ideal = distorted * _inverse_radius_ratio(np.linalg.norm(distorted, axis=1), k)[:, None]
    _, slope, by_k = _radial(ideal, k)
    change = np.zeros((len(pixels), 2, 5))
    change[:, :, 0] = -distorted
    change[:, 0, 1] = change[:, 1, 2] = -1 / focal
    change[:, :, 3:] = -by_k
    derivatives = np.zeros((len(pixels), 3, 5))
    derivatives[:, :2] = _inverse_2x2(slope) @ change
    return np.concatenate([ideal, np.ones((len(ideal), 1))], axis=1), derivatives


def project(device: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Pixels (N, 2), their derivatives (N, 2, 3) by the point and (N, 2, 5) by log f, x_0, y_0, k1, k2."""
    focal, centre, k = device[0], device[1:3], device[3:]
    ideal = points[:, :2] / points[:, 2:]
    distorted, slope, by_k = _radial(ideal, k)
    by_point = np.zeros((len(points), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1.0
    by_point[:, :, 2] = -ideal
    by_point /= points[:, 2, None, None]
    by_device = np.zeros((len(points), 2, 5))
    by_device[:, :, 0] = focal * distorted
    by_device[:, 0, 1] = by_device[:, 1, 2] = 1.0
    by_device[:, :, 3:] = focal * by_k
    return focal * distorted + centre, focal * slope @ by_point, by_device


def _inverse_radius_ratio(distorted: Floats, k: Floats) -> Floats:
    """r / r_d (N,) for distorted radii (N,), by Newton's method on r (1 + k1 r² + k2 r⁴) = r_d."""
    ideal = distorted.copy()
    for _ in range(_UNDISTORT_STEPS):
        r2 = ideal**2
        step = (ideal * (1 + r2 * (k[0] + r2 * k[1])) - distorted) / (1 + r2 * (3 * k[0] + 5 * r2 * k[1]))
        ideal = ideal - step
        if np.abs(step).max(initial=0.0) < 1e-13:
            break
    return np.where(distorted > 0, ideal / np.where(distorted > 0, distorted, 1.0), 1.0)


def _inverse_2x2(matrices: Floats) -> Floats:
    """Inverses of (N, 2, 2)."""
    a, b, c, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1]
    adjugate = np.stack([d, -b, -c, a], axis=1).reshape(-1, 2, 2)
    inverse: Floats = adjugate / (a * d - b * c)[:, None, None]
    return inverse


def _radial(ideal: Floats, k: Floats) -> tuple[Floats, Floats, Floats]:
    """x (1 + k1 r² + k2 r⁴) of (N, 2), its Jacobian (N, 2, 2) by x and (N, 2, 2) by k1, k2."""
    r2 = np.sum(ideal**2, axis=1)
    factor = 1 + r2 * (k[0] + r2 * k[1])
    slope = 2 * (k[0] + 2 * k[1] * r2)
    jacobian = slope[:, None, None] * ideal[:, :, None] * ideal[:, None, :]
    jacobian[:, 0, 0] += factor
    jacobian[:, 1, 1] += factor
    return ideal * factor[:, None], jacobian, ideal[:, :, None] * np.stack([r2, r2**2], axis=1)[:, None, :]
