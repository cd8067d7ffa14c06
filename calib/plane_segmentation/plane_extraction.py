"""Extract planes from surfels one after the other; the parallax of a plane is an affine function of the image."""

import cv2
import numpy as np

from calib.numerics import Floats, Ints
from calib.plane_segmentation.region_growing import grow, local_planes
from calib.plane_segmentation.surfels import SurfelEquations, Surfels

NO_PLANE = -1
_SEEDS = 80
_GATE, _GATE_3D = 3.5, 4.5  # in sigmas: for one number, and for the norm of three
_MOST_PLANES = 16
# A plane that holds fewer surfels than this, or this share of all, is of no use to a calibration.
_FEWEST_SURFELS, _LEAST_SHARE = 12, 0.004
# The standard deviation, in sigmas, of errors that fill the gate evenly is 2.
_MOST_SCATTER = 1.3
_CLOSE = 15.0


def find_planes(surfels: Surfels, evidence: SurfelEquations, rng: np.random.Generator) -> tuple[Floats, Ints]:
    """Return planes (n, 3), largest first, and the plane of each surfel (M,), NO_PLANE for none."""
    seeds, covariance, usable = local_planes(surfels, evidence.rows, _GATE)
    fewest = _fewest(len(surfels))
    across = np.abs(evidence.across)
    free = across < _GATE + 3 * np.median(across * evidence.sigma) / evidence.sigma
    planes: list[Floats] = []
    while len(planes) < _MOST_PLANES and np.any(free & usable):
        pool = np.flatnonzero(free & usable)
        picked = pool[rng.permutation(len(pool))[:_SEEDS]]
        remaining = np.flatnonzero(free)
        plane, inlier = grow(evidence.rows.take(remaining, axis=1), seeds[picked], covariance[picked], _GATE)
        if np.count_nonzero(inlier) < fewest:
            usable[picked] = False
            continue
        planes.append(plane)
        free[remaining[inlier]] = False
    if not planes:
        return np.empty((0, 3)), np.full(len(surfels), NO_PLANE, np.int32)
    return _assign(surfels, evidence, np.stack(planes))


def _fewest(surfels: int) -> int:
    return max(_FEWEST_SURFELS, round(_LEAST_SHARE * surfels))


def _assign(surfels: Surfels, evidence: SurfelEquations, planes: Floats) -> tuple[Floats, Ints]:
    """Assign each surfel to its best plane; drop planes and components with too few. Returns as `find_planes`."""
    fewest, error = _fewest(len(surfels)), _errors(evidence, planes)
    while True:
        label = np.argmin(error, axis=0).astype(np.int32)
        label[error.min(axis=0) > 1] = NO_PLANE
        label = _without_islands(surfels, label, len(planes))
        counts = np.bincount(label[label >= 0], minlength=len(planes))
        if counts.min() >= fewest:
            break
        # Drop the smallest first: its surfels may complete another plane.
        smallest = np.argmin(counts)
        planes, error = np.delete(planes, smallest, axis=0), np.delete(error, smallest, axis=0)
        if len(planes) == 0:
            return planes, np.full(len(surfels), NO_PLANE, np.int32)
    order = np.argsort(-counts, kind="stable")
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    return planes[order], np.where(label >= 0, rank[label], NO_PLANE).astype(np.int32)


def without_uneven(evidence: SurfelEquations, planes: Floats, label: Ints) -> tuple[Floats, Ints, float]:
    """Drop planes whose surfels scatter over the whole tolerance: patches of a curved or bumpy surface that end where
    the surface leaves the tolerance. Also return the share of surfels on the largest dropped plane.
    """
    if len(planes) == 0:
        return planes, label, 0.0
    error = evidence.off_own(planes, label)
    kept = [plane for plane in range(len(planes)) if np.std(error[label == plane]) < _MOST_SCATTER]
    renumbered = np.full(len(planes) + 1, NO_PLANE, np.int32)
    renumbered[kept] = np.arange(len(kept))
    dropped = [float(np.mean(label == plane)) for plane in range(len(planes)) if plane not in kept]
    return planes[kept], renumbered[label], max(dropped, default=0.0)


def covariances(evidence: SurfelEquations, label: Ints, planes: int) -> Floats:
    """Return the covariance of each plane (n, 3, 3) from the surfels on it."""
    information = np.zeros((planes, 3, 3))
    for plane in range(planes):
        x = evidence.rows[1:4, label == plane]
        information[plane] = x @ x.T
    # Large instead of infinite along what surfels in one line leave open.
    ridge = 1e-12 * np.trace(information, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.linalg.inv(information + ridge)


def spill(evidence: SurfelEquations, planes: Floats, label: Ints) -> float:
    """Return the number of surfels close to but not on the three largest planes, relative to those on them.

    Nearly zero for planes; more than half if the tolerance cuts uneven surfaces into slices; infinite without planes.
    """
    if len(planes) == 0:
        return np.inf
    largest = np.argsort(-np.bincount(label[label >= 0], minlength=len(planes)), kind="stable")[:3]
    error = np.abs(evidence.off(planes[largest]))
    close = int(np.count_nonzero((error < _CLOSE) & (label != largest[:, None])))
    return close / max(1, int(np.count_nonzero(np.isin(label, largest))))


def _errors(evidence: SurfelEquations, planes: Floats) -> Floats:
    """Return the squared error of each surfel for each plane (n, M), summed over its three numbers, over the gate's."""
    value, slope_x, slope_y = (evidence.off(planes, number) ** 2 for number in range(3))
    return (value + slope_x + slope_y) / _GATE_3D**2


def _without_islands(surfels: Surfels, label: Ints, planes: int) -> Ints:
    """Remove labels of connected components of fewer than four cells: chance agreements, as along a crease."""
    grid = surfels.grid
    kept = label.copy()
    for plane in range(planes):
        image = np.zeros(grid.rows * grid.columns, np.uint8)
        image[surfels.cell[label == plane]] = 1
        _, component, stats, _ = cv2.connectedComponentsWithStats(image.reshape(grid.rows, grid.columns))
        small = stats[:, cv2.CC_STAT_AREA] < 4
        kept[(label == plane) & small[component.ravel()[surfels.cell]]] = NO_PLANE
    return kept
