"""Surfels → planes: which of them have a parallax that is one affine function of the image."""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.arrays import Bools, Floats, Ints
from calib.pieces import in_pieces
from calib.surfels import Surfels
from calib.two_view import TwoView

NO_PLANE = -1
_SEEDS = 80
_GROWTH_STEPS = 6
_GATE, _GATE_3D = 3.5, 4.5  # in sigmas: for one number, and for the length of three
_MOST_PLANES = 16
_PATCHES = (3, 5)  # cells along the side of the patch that a seed starts from; the larger if it is one plane
_FEWEST_IN_PATCH = 6
# A plane that holds fewer surfels than this, or this share of all, is of no use to a calibration.
_FEWEST_SURFELS, _LEAST_SHARE = 12, 0.004
# The standard deviation, in sigmas, of errors that fill the gate evenly is 2.
_MOST_SCATTER = 1.3
_CLOSE = 15.0
# Where a symmetric matrix's six numbers are, and which of them is where.
_UPPER = np.triu_indices(3)
_SQUARE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True)
class Evidence:
    """What each surfel says about the plane it lies on; everything in projector pixels.

    A plane v (3,) is off by `value` − `x` · v at the surfel, and off by `slope` − `dx` · v per camera pixel along both
    axes. `value` (M,), `x` (M, 3), `slope` (M, 2), `dx` (M, 2, 3); `sigma` (M,), `slope_sigma` (M, 2) their standard
    deviations; `across` (M,) distance from the epipolar line.
    """

    value: Floats
    x: Floats
    sigma: Floats
    slope: Floats
    dx: Floats
    slope_sigma: Floats
    across: Floats

    def __getitem__(self, chosen: Bools | Ints) -> "Evidence":
        """The evidence of some of the surfels."""
        return Evidence(
            self.value[chosen],
            self.x[chosen],
            self.sigma[chosen],
            self.slope[chosen],
            self.dx[chosen],
            self.slope_sigma[chosen],
            self.across[chosen],
        )


def gather_evidence(surfels: Surfels, view: TwoView, model_px: float) -> Evidence:
    """`model_px`: standard deviation of what the lens model and the decoder's systematic errors leave."""
    step = surfels.grid.side_px / 2
    here = view.parallax(surfels.camera_px, surfels.projector_px)
    slopes, dx = [], []
    for axis in (0, 1):
        shift = step * np.eye(2)[axis]
        moved = surfels.jacobian @ shift
        ahead = view.parallax(surfels.camera_px + shift, surfels.projector_px + moved)
        behind = view.parallax(surfels.camera_px - shift, surfels.projector_px - moved)
        slopes.append((ahead.value - behind.value) / (2 * step * here.per_px))
        dx.append((ahead.x - behind.x) / (2 * step * here.per_px[:, None]))
    sigma = np.hypot(surfels.sigma_px / np.sqrt(surfels.count), model_px)
    variance = np.diagonal(np.linalg.inv(surfels.spread), axis1=1, axis2=2) * surfels.sigma_px[:, None] ** 2
    return Evidence(
        here.value / here.per_px,
        here.x / here.per_px[:, None],
        sigma,
        np.stack(slopes, axis=1),
        np.stack(dx, axis=1),
        # A model error that varies over the width of some cells has a slope, too.
        np.sqrt(variance + (model_px / (4 * step)) ** 2),
        here.across_px,
    )


def find_planes(surfels: Surfels, evidence: Evidence, rng: np.random.Generator) -> tuple[Floats, Ints]:
    """Planes (n, 3), largest first, and which plane each surfel lies on, (M,), NO_PLANE for none."""
    seeds, seeds_covariance, usable = _local_planes(surfels, evidence)
    fewest = max(_FEWEST_SURFELS, round(_LEAST_SHARE * len(surfels)))
    free = np.abs(evidence.across) < _GATE * evidence.sigma + 3 * np.median(np.abs(evidence.across))
    planes: list[Floats] = []
    while len(planes) < _MOST_PLANES and np.count_nonzero(free & usable) >= 1:
        pool = np.flatnonzero(free & usable)
        picked = pool[rng.permutation(len(pool))[:_SEEDS]]
        left = np.flatnonzero(free)
        plane, inlier = _grow(evidence[left], seeds[picked], seeds_covariance[picked])
        if np.count_nonzero(inlier) < fewest:
            usable[picked] = False
            continue
        planes.append(plane)
        free[left[inlier]] = False
    if not planes:
        return np.empty((0, 3)), np.full(len(surfels), NO_PLANE, np.int32)
    return _assign(surfels, evidence, np.stack(planes))


def _assign(surfels: Surfels, evidence: Evidence, planes: Floats) -> tuple[Floats, Ints]:
    """Give each surfel to the plane that fits it best, drop planes and places with too few; as `find_planes`."""
    fewest = max(_FEWEST_SURFELS, round(_LEAST_SHARE * len(surfels)))
    while True:
        error = _errors(evidence, planes)
        label = np.argmin(error, axis=0).astype(np.int32)
        label[error.min(axis=0) > 1] = NO_PLANE
        label = _without_islands(surfels, label, len(planes))
        counts = np.bincount(label[label >= 0], minlength=len(planes))
        if counts.size == 0 or counts.min() >= fewest:
            break
        # The smallest goes first: its surfels may belong to one that is short of a few.
        planes = np.delete(planes, np.argmin(counts), axis=0)
        if len(planes) == 0:
            return planes, np.full(len(surfels), NO_PLANE, np.int32)
    order = np.argsort(-counts, kind="stable")
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order))
    return planes[order], np.where(label >= 0, rank[label], NO_PLANE).astype(np.int32)


def without_uneven(evidence: Evidence, planes: Floats, label: Ints) -> tuple[Floats, Ints]:
    """Drop planes whose surfels scatter over all of the tolerance: patches of a curved or bumpy surface, which end
    where the surface leaves the tolerance and not where a plane ends.
    """
    if len(planes) == 0:
        return planes, label
    error = (evidence.value - np.sum(evidence.x * planes[label], axis=1)) / evidence.sigma
    kept = [plane for plane in range(len(planes)) if np.std(error[label == plane]) < _MOST_SCATTER]
    renumbered = np.full(len(planes) + 1, NO_PLANE, np.int32)
    renumbered[kept] = np.arange(len(kept))
    return planes[kept], renumbered[label]


def covariances(evidence: Evidence, label: Ints, planes: int) -> Floats:
    """Covariance of each of so many planes, (n, 3, 3), from the surfels on it."""
    x = evidence.x / evidence.sigma[:, None]
    information = np.zeros((planes, 3, 3))
    for plane in range(planes):
        information[plane] = x[label == plane].T @ x[label == plane]
    return _inverses(information)


def spill(evidence: Evidence, planes: Floats, label: Ints) -> float:
    """How many surfels lie close to the three largest planes without lying on them, relative to those that do.

    Next to nothing for planes; more than half if the tolerance cuts uneven surfaces into slices; infinite if there are
    no planes.
    """
    if len(planes) == 0:
        return np.inf
    largest = np.argsort(-np.bincount(label[label >= 0], minlength=len(planes)), kind="stable")[:3]
    error = np.abs(evidence.value - planes[largest] @ evidence.x.T) / evidence.sigma
    close = int(np.count_nonzero((error < _CLOSE) & (label != largest[:, None])))
    return close / max(1, int(np.count_nonzero(np.isin(label, largest))))


def _errors(evidence: Evidence, planes: Floats) -> Floats:
    """How far each surfel is from each plane, (n, M): the sum of squares of its three numbers over the gate's."""
    value = (evidence.value - planes @ evidence.x.T) / evidence.sigma
    slope = (evidence.slope - np.einsum("mai,ni->nma", evidence.dx, planes)) / evidence.slope_sigma
    errors: Floats = (value**2 + np.sum(slope**2, axis=2)) / _GATE_3D**2
    return errors


def _inverses(normal: Floats) -> Floats:
    """Inverses of normal matrices (n, 3, 3); large instead of infinite along what surfels in one line leave open."""
    ridge = 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    inverse: Floats = np.linalg.inv(normal + ridge)
    return inverse


def _local_planes(surfels: Surfels, evidence: Evidence) -> tuple[Floats, Floats, Bools]:
    """The plane through the patch around each surfel (M, 3), its covariance (M, 3, 3), and whether it is a plane."""
    grid = surfels.grid
    rows = np.concatenate([evidence.x, evidence.value[:, None]], axis=1) / evidence.sigma[:, None]
    moments = np.zeros((grid.rows * grid.columns, 17))
    moments[surfels.cell, :16] = (rows[:, :, None] * rows[:, None, :]).reshape(-1, 16)
    moments[surfels.cell, 16] = 1
    image = moments.reshape(grid.rows, grid.columns, 17)
    planes, covariance = np.zeros((len(surfels), 3)), np.zeros((len(surfels), 3, 3))
    usable = np.zeros(len(surfels), np.bool_)
    for side in _PATCHES:
        filtered = cv2.boxFilter(image, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        sums = filtered.astype(np.float64).reshape(-1, 17)[surfels.cell]
        normal, count = sums[:, :16].reshape(-1, 4, 4), sums[:, 16]
        enough = np.flatnonzero(count >= _FEWEST_IN_PATCH)
        normal, count = normal[enough], count[enough]
        inverse = _inverses(normal[:, :3, :3])
        plane = np.einsum("mij,mj->mi", inverse, normal[:, :3, 3])
        chi2 = normal[:, 3, 3] - np.sum(plane * normal[:, :3, 3], axis=1)
        good = chi2 < _GATE * (count - 3)
        planes[enough[good]], covariance[enough[good]], usable[enough[good]] = plane[good], inverse[good], True
    return planes, covariance, usable


def _grow(evidence: Evidence, planes: Floats, covariance: Floats) -> tuple[Floats, Bools]:
    """Refit each seed (S, 3) to all surfels that it explains, as far as its uncertainty reaches; the largest result."""
    x, value = evidence.x / evidence.sigma[:, None], evidence.value / evidence.sigma
    products = _products(x)
    for _ in range(_GROWTH_STEPS):
        weight = _explained(evidence, planes, covariance, reach=25.0).astype(np.float64)
        normal = (weight.T @ products)[:, _SQUARE]
        enough = weight.sum(axis=0) >= 6
        normal, weight = normal[enough], weight[:, enough]
        covariance = _inverses(normal)
        planes = np.einsum("sij,sj->si", covariance, weight.T @ (x * value[:, None]))
    if len(planes) == 0:
        return np.zeros(3), np.zeros(len(value), np.bool_)
    inlier = _explained(evidence, planes, covariance, reach=0.0)
    best = int(np.argmax(np.count_nonzero(inlier, axis=0)))
    return planes[best], inlier[:, best]


def _explained(evidence: Evidence, planes: Floats, covariance: Floats, reach: float) -> Bools:
    """Which surfels lie on each of the planes (S, 3) and slope like it, (M, S).

    A plane's own uncertainty widens the gate for its offset up to `reach` times the surfel's variance.
    """
    result = np.empty((len(evidence.value), len(planes)), np.bool_)
    # With xᵀ C x of symmetric matrices as a product of six numbers each.
    doubled = covariance[:, *_UPPER] * np.where(_UPPER[0] == _UPPER[1], 1.0, 2.0)

    def judge(at: slice) -> None:
        sigma = evidence.sigma[at, None]
        off = evidence.value[at, None] - evidence.x[at] @ planes.T
        variance = sigma * sigma
        if reach:
            variance = variance + np.minimum(_products(evidence.x[at]) @ doubled.T, reach * variance)
        explained = off * off < _GATE**2 * variance
        for axis in (0, 1):
            dx, sigma = evidence.dx[at, axis], evidence.slope_sigma[at, axis, None]
            off = evidence.slope[at, axis, None] - dx @ planes.T
            explained &= off * off < _GATE**2 * (sigma * sigma + _products(dx) @ doubled.T)
        result[at] = explained

    in_pieces(len(result), judge, width=len(planes))
    return result


def _products(x: Floats) -> Floats:
    """The six different products of the coordinates of x (M, 3), (M, 6)."""
    products: Floats = x[:, _UPPER[0]] * x[:, _UPPER[1]]
    return products


def _without_islands(surfels: Surfels, label: Ints, planes: int) -> Ints:
    """Take away labels of pieces of fewer than four connected cells: chance agreements, as along a crease."""
    grid = surfels.grid
    kept = label.copy()
    for plane in range(planes):
        image = np.zeros(grid.rows * grid.columns, np.uint8)
        image[surfels.cell] = label == plane
        _, component, stats, _ = cv2.connectedComponentsWithStats(image.reshape(grid.rows, grid.columns))
        small = np.flatnonzero(stats[:, cv2.CC_STAT_AREA] < 4)
        kept[(label == plane) & np.isin(component.ravel()[surfels.cell], small)] = NO_PLANE
    return kept
