"""A device from points in space that it sees, by the direct linear transform (Hartley & Zisserman, section 7.1)."""

import numpy as np

from calib.closed_form.transfer import decompose
from calib.geometry import Motion, homogeneous
from calib.numerics import Floats, normalisation

# Of the largest eigenvalue, and over the smallest one: less, and points on one plane leave the device open.
_TOLD, _OVER_NOISE = 1e-9, 30.0


def resected(points: Floats, pixels: Floats) -> tuple[Floats, Motion] | None:
    """The matrix (3, 3) of a device without lens that sees points (N, 3) at pixels (N, 2), and the motion to it; None
    of points on one plane, or behind it.
    """
    scale, centre = normalisation(pixels), points.mean(axis=0)
    spread = float(np.sqrt(np.mean(np.sum((points - centre) ** 2, axis=1))))
    ideal = homogeneous(pixels) @ scale.T
    solid = homogeneous((points - centre) / spread)
    rows = np.zeros((2 * len(points), 12))
    rows[0::2, 0:4], rows[0::2, 8:12] = solid, -ideal[:, :1] * solid
    rows[1::2, 4:8], rows[1::2, 8:12] = solid, -ideal[:, 1:2] * solid
    values, vectors = np.linalg.eigh(rows.T @ rows)
    if values[1] < max(_TOLD * values[-1], _OVER_NOISE * values[0]):
        return None
    before = np.linalg.inv(scale) @ vectors[:, 0].reshape(3, 4)
    matrix, rotation, translation = (each[0] for each in decompose(before[None]))
    motion = Motion(rotation, spread * translation - rotation @ centre)
    depths = points @ rotation[2] + motion.translation[2]
    return (matrix, motion) if np.isfinite(rotation).all() and np.median(depths) > 0 else None
