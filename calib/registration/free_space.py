"""Free space of a cloud whose scanner's place is known: what would have hidden a measured point is not there."""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, evenly_spread, median

_SAMPLE = 2000
_SPACINGS = 2.0  # angular distances of neighbouring points in an edge of a bin
_MOST_BINS = 4_000_000
_MARGIN = 0.01  # of the range


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Least ranges of a scan over the sphere of directions from its scanner."""

    eye: Floats
    """(3,): the scanner."""
    near: NDArray[np.float32]
    """(H, W): the least range around each bin of azimuth and inclination; 0 where a bin near it has no point."""
    bins_per_rad: float

    @classmethod
    def of(cls, points: Floats, eye: Floats) -> "FreeSpace":
        """Of points (N, 3) that were seen from one place."""
        ways, ranges = _ways(points, eye)
        tree = scipy.spatial.cKDTree(ways, balanced_tree=False, compact_nodes=False)
        spacing = median(np.asarray(tree.query(evenly_spread(ways, _SAMPLE), 4)[0])[:, -1]) / 1.5
        per_rad = min(1 / max(_SPACINGS * spacing, 1e-9), float(np.sqrt(_MOST_BINS / (2 * np.pi**2))))
        shape = int(np.ceil(np.pi * per_rad)) + 1, int(np.ceil(2 * np.pi * per_rad)) + 1
        row, column = _bins(ways, per_rad)
        near = np.full(shape, np.inf, np.float32)
        np.minimum.at(near, (row, column), ranges.astype(np.float32))
        kernel = np.ones((3, 3), np.uint8)
        least = cv2.erode(near, kernel)
        known = cv2.erode(np.isfinite(near).astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        return cls(eye, np.where(known > 0, least, np.float32(0)), per_rad)

    def is_violated(self, points: Floats, by: float) -> Bools:
        """Which points (N, 3) are in front of what was seen, by more than a distance, (N,)."""
        ways, ranges = _ways(points, self.eye)
        near = self.near[_bins(ways, self.bins_per_rad)].astype(np.float64)
        violated: Bools = (near > 0) & (ranges * (1 + _MARGIN) + by < near)
        return violated


def _ways(points: Floats, eye: Floats) -> tuple[Floats, Floats]:
    """Unit directions (N, 3) of points from an eye, and ranges (N,)."""
    ways = points - eye
    ranges = np.linalg.norm(ways, axis=1)
    return ways / np.maximum(ranges, 1e-300)[:, None], ranges


def _bins(ways: Floats, per_rad: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    inclination = np.arccos(np.clip(ways[:, 1], -1, 1))
    azimuth = np.arctan2(ways[:, 0], ways[:, 2]) + np.pi
    return (inclination * per_rad).astype(np.int64), (azimuth * per_rad).astype(np.int64)
