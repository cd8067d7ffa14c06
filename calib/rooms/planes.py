"""A plane of a room."""

from dataclasses import dataclass

import numpy as np

from calib.numerics import Floats

PER_PLANE = 3  # columns: two tilts, along `tangent_basis` of its normal, and the offset


@dataclass(frozen=True, eq=False)
class RoomPlane:
    """The points X with `normal` · X = `offset`; `normal` (3,), of length 1, points to the side it was seen from."""

    normal: Floats
    offset: float


def plane_through(points: Floats, weight: Floats, seen_from: Floats | None = None) -> RoomPlane:
    """Least squares through points (N, 3) of `weight` (N,); `seen_from` (3,): the side its normal points to, by default
    the origin's.
    """
    centre = np.average(points, axis=0, weights=weight)
    off = points - centre
    normal = np.linalg.eigh((weight[:, None] * off).T @ off)[1][:, 0]
    towards = -centre if seen_from is None else seen_from - centre
    if normal @ towards < 0:
        normal = -normal
    return RoomPlane(normal, float(normal @ centre))
