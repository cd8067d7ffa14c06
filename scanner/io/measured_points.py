"""What of a cloud's numbers can have been measured: points near the others, each once, and normals that
are directions."""

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats

_ODD, _ODD_TOO = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_INNER = 0.9  # share of the points, whose distances from the middle are the measure
_LEAST_USABLE = 0.95  # share of the normals, below which none is used


def are_stray(points: Floats, most: float) -> Bools:
    """Which of finite points (N, 3) are farther from the middle than `most` times what nine tenths are, (N,)."""
    if not len(points):
        return np.zeros(0, np.bool_)
    with np.errstate(over="ignore"):
        away = np.abs(points - np.median(points, axis=0)).max(axis=1)
    inner = float(np.quantile(away, _INNER))
    stray: Bools = away > most * inner if inner > 0 else np.zeros(len(points), np.bool_)
    return stray


def usable_normals(points: Floats, normals: Floats) -> Floats | None:
    """Normals (N, 3) of points (N, 3) with unit length. The few that are zero or no numbers become those of the nearest
    points that have one; None if there are more than a few.
    """
    from scipy.spatial import cKDTree

    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(normals, axis=1)
        usable: Bools = np.isfinite(length) & (length > 0)
    if not len(points) or np.mean(usable) < _LEAST_USABLE:
        return None
    unit = normals / np.where(usable, length, 1.0)[:, None]
    if not usable.all():
        nearest = np.asarray(cKDTree(points[usable]).query(points[~usable])[1])
        unit[~usable] = unit[usable][nearest]
    return unit


def are_repeated(points: Floats) -> Bools:
    """Which of points (N, 3) are exactly where one before them is, (N,), by numbers of 64 bits for the places."""
    bits = np.ascontiguousarray(points + 0.0).view(np.uint64)  # without −0
    mixed: NDArray[np.uint64] = np.zeros(len(points), np.uint64)
    for column in bits.T:
        mixed = (mixed ^ column) * _ODD  # SplitMix64, Steele et al. 2014
        mixed = (mixed ^ (mixed >> np.uint64(30))) * _ODD_TOO
        mixed ^= mixed >> np.uint64(27)
    repeated: Bools = np.ones(len(points), np.bool_)
    repeated[np.unique(mixed, return_index=True)[1]] = False
    return repeated
