"""A point-to-plane step of one pose, for compiled descents of thousands of them.

Descents differ in what they pair; what they do with the pairs is the same.
"""

import numpy as np

from calib.geometry import rotation_about
from calib.numerics import Floats, compiled, inlined


@inlined
def add_pair(
    matrix: Floats,
    gradient: Floats,
    arm: tuple[float, float, float],
    normal: tuple[float, float, float],
    off: float,
    weight: float,
) -> None:
    """Add a pair to normal equations (6, 6), (6,) of a rotation about a centre, and a shift.

    `arm`: from the centre to the point; `off`: its distance from the plane, along the `normal`.
    """
    u, v, w = arm
    p, q, s = np.float64(normal[0]), np.float64(normal[1]), np.float64(normal[2])
    row = v * s - w * q, w * p - u * s, u * q - v * p, p, q, s
    for i in range(6):
        for j in range(6):
            matrix[i, j] += weight * row[i] * row[j]
        gradient[i] += weight * off * row[i]


@compiled
def step_pose(
    matrix: Floats, gradient: Floats, damping: float, centre: Floats, rotation: Floats, translation: Floats
) -> float:
    """Solve the normal equations, in place, and move a pose (3, 3), (3,), in place. Returns the largest number of the
    twist about the centre (3,); 0 where nothing holds the pose.

    `damping`: relative to the trace of rotations, and to that of shifts.
    """
    trace_turn = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    trace_shift = matrix[3, 3] + matrix[4, 4] + matrix[5, 5]
    if not trace_turn * trace_shift > 0:
        return 0.0
    for i in range(3):
        matrix[i, i] += damping * trace_turn
        matrix[i + 3, i + 3] += damping * trace_shift
    twist: Floats = -np.linalg.solve(matrix, gradient).astype(np.float64)
    turn = rotation_about(twist[:3])
    rotation[:] = turn @ rotation
    translation[:] = turn @ (translation - centre) + centre + twist[3:]
    return float(np.abs(twist).max())
