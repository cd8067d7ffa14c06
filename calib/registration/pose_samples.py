"""Poses to begin with: rotations that cover all directions and turns evenly, and what is distinct of many poses."""

import numpy as np
import scipy

from calib.geometry import Pose
from calib.numerics import Floats, distinct

# Radicals of super-Fibonacci spirals: φ² = 2, ψ⁴ = ψ + 4.
_PHI, _PSI = 2**0.5, 1.533751168755204288118041


def even_rotations(count: int) -> Floats:
    """Rotations (count, 3, 3): any rotation is about 180° / ∛count from the nearest.

    Alexa, "Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3)", 2022.
    """
    s = np.arange(count) + 0.5
    near, far = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / _PHI, 2 * np.pi * s / _PSI
    quaternions = near * np.sin(alpha), near * np.cos(alpha), far * np.sin(beta), far * np.cos(beta)
    return scipy.spatial.transform.Rotation.from_quat(np.stack(quaternions, axis=1)).as_matrix()


def distinct_poses(poses: Pose, worth: Floats, turn: float, shift: float, most: int) -> list[int]:
    """Numbers of the best of K poses by their `worth` (K,), each by a `turn` in radians or a `shift` away from better
    ones.
    """
    order = np.argsort(-worth, kind="stable")
    ordered = poses[order]
    return [int(order[k]) for k in distinct(len(order), lambda k: ordered.is_near(ordered[k], turn, shift), most)]
