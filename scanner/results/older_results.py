"""Results of versions that wrote less: what their files do not say is found again."""

import numpy as np
import scipy

from calib.geometry import Calibration, Matches, intersect
from calib.numerics import Bools, Floats, Ints

# Cloud coordinates are rounded to 24 bits, far less than this share of a point's distance.
_SAME_POINT = 1e-5


def same_points(points: Floats, others: Floats) -> Bools:
    """Which points (N, 3) of a file are those others, (N,), but for the file's rounding."""
    apart = np.linalg.norm(others - points, axis=1)
    same: Bools = apart <= _SAME_POINT * np.linalg.norm(points, axis=1)
    return same


def find_matches(points: Floats, matches: Matches, calibration: Calibration) -> Ints | None:
    """Which match each point (N, 3) was triangulated from, (N,), or None if there is a point that none gives."""
    met = intersect(matches, calibration)
    usable = np.flatnonzero(met.in_front)
    if not len(usable):
        return None
    nearest = usable[scipy.spatial.cKDTree(met.points[usable]).query(points)[1]]
    return nearest if np.all(same_points(points, met.points[nearest])) else None
