"""Plane segments of an organised cloud: floor, walls, and planes of furniture.

Small square cells of the image, each with its own plane, are grouped into planes, the one that explains most surface
first. Then every pixel is assigned to the nearest plane. Calibration errors bend a room's planes by some thousandths of
the distance, which the tolerance includes.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Plane
from calib.numerics import Bools, Floats, Ints, compiled, robust_sigma

NO_PLANE = -1
# Largest distance of a point from its plane: relative to its depth, for calibration errors, and in sigmas.
_BENT, _SIGMAS = 0.006, 3.0
_LIKE_CELL, _LIKE_PIXEL = np.cos(np.radians(12.0)), np.cos(np.radians(30.0))
_CELLS_ACROSS = 100
_SEEDS, _ROUNDS = 40, 5
_MOST_PLANES = 24
# Least share of a picture's cells on a plane, and of the picture's pixels on a piece of it.
_LEAST_SHARE, _LEAST_PIECE = 0.003, 0.0005
_FITTED = 4000
# Largest depth difference of pieces of one plane, relative to their depth.
_PARTED = 0.004


@dataclass(frozen=True, eq=False)
class Facets:
    """Small pieces of surface."""

    centre: Floats
    """(N, 3)"""
    normal: Floats
    """(N, 3)"""
    tolerance: Floats
    """(N,): largest distance from the plane that one is on."""

    def on(self, plane: Plane) -> Bools:
        """Which of them (N,) lie on a plane with the same slope."""
        off: Bools = np.abs(plane.heights(self.centre)) < self.tolerance
        like: Bools = off & (self.normal @ plane.normal > _LIKE_CELL)
        return like

    def plane(self, chosen: Bools) -> Plane:
        """Through some of them (N,), towards the side of their normals."""
        centre = self.centre[chosen]
        return Plane.through(centre, 1 / self.tolerance[chosen] ** 2, centre[0] + self.normal[chosen].sum(axis=0))


def relative_noise(points: NDArray[np.float32], normals: NDArray[np.float32]) -> float:
    """Standard deviation of a point along its ray over its depth squared, from how neighbours (H, W, 3) differ."""
    middle, left, right = points[:, 1:-1], points[:, :-2], points[:, 2:]
    with np.errstate(invalid="ignore", divide="ignore"):
        slant = np.sum(normals[:, 1:-1] * middle, axis=2)
        inverse = [np.float32(1.0) / points_of_side[..., 2] for points_of_side in (left, middle, right)]
        # Inverse depth is linear on a plane. The second difference of three equal variances has six times the variance.
        bend = (inverse[0] - 2 * inverse[1] + inverse[2])[slant < 0]
    bend = bend[np.isfinite(bend)]
    return robust_sigma(bend[:: max(1, len(bend) // 100_000)].astype(np.float64)) / float(np.sqrt(6.0))


def find_segments(
    points: NDArray[np.float32], normals: NDArray[np.float32], noise: float
) -> tuple[NDArray[np.int32], tuple[Plane, ...]]:
    """The plane of each pixel (H, W), NO_PLANE for none, and the planes, the one with most surface first.

    `points`, `normals` (H, W, 3) in the camera's frame, normals towards the camera; `noise` as of `relative_noise`.
    """
    cells = _cells(points, normals, noise)
    planes = grow_planes(cells, _MOST_PLANES, max(8, _LEAST_SHARE * len(cells.centre)))
    labels = _assigned(points, normals, noise, planes)
    fitted = []
    for label in range(len(planes)):
        own = np.flatnonzero(labels.ravel() == label)
        some = points.reshape(-1, 3)[own[:: max(1, len(own) // _FITTED)]].astype(np.float64)
        fitted.append(Plane.through(some, 1 / (noise * some[:, 2] ** 2 + _BENT / _SIGMAS * some[:, 2]) ** 2))
    return labels, tuple(fitted)


def _tolerance(depth: Floats, noise: float) -> Floats:
    return _BENT * depth + _SIGMAS * noise * depth * depth


def _cells(points: NDArray[np.float32], normals: NDArray[np.float32], noise: float) -> Facets:
    """Cells whose points and normals agree."""
    height, width = points.shape[:2]
    side = max(2, round(width / _CELLS_ACROSS))
    rows, columns = height // side, width // side

    def tiled(values: NDArray[np.float32]) -> Floats:
        cut = values[: rows * side, : columns * side].astype(np.float64)
        in_cells = cut.reshape(rows, side, columns, side, 3).swapaxes(1, 2)
        return in_cells.reshape(rows * columns, side * side, 3)

    at, towards = tiled(points), tiled(normals)
    there = np.isfinite(at[..., 2]) & np.isfinite(towards[..., 2])
    full = np.count_nonzero(there, axis=1) > side * side / 2
    at, towards, there = at[full], towards[full], there[full]
    count = np.count_nonzero(there, axis=1)[:, None]
    at, towards = np.where(there[..., None], at, 0.0), np.where(there[..., None], towards, 0.0)
    centre, normal = at.sum(axis=1) / count, towards.sum(axis=1) / count
    straight = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(straight, 1e-12)[:, None]
    off = np.einsum("nki,ni->nk", at - centre[:, None], normal)
    rms = np.sqrt(np.sum(np.where(there, off, 0.0) ** 2, axis=1) / count[:, 0])
    tolerance = _tolerance(centre[:, 2], noise)
    slant = -np.sum(normal * centre, axis=1) / np.linalg.norm(centre, axis=1)
    good = (straight > _LIKE_CELL) & (rms < tolerance) & (slant > 0.05)
    return Facets(centre[good], normal[good], tolerance[good])


def grow_planes(cells: Facets, most_planes: int, fewest: float) -> list[Plane]:
    """Planes of at least the `fewest` facets, the one with most of them first."""
    rng = np.random.default_rng(0)
    planes: list[Plane] = []
    failures = 0
    while len(planes) < most_planes and failures < 3 and len(cells.centre) >= fewest:
        seeds = rng.choice(len(cells.centre), min(_SEEDS, len(cells.centre)), replace=False)
        grown = [_grown(cells.centre, cells.normal, cells.tolerance, int(seed)) for seed in seeds]
        best = max(grown, key=np.count_nonzero)
        if np.count_nonzero(best) < max(fewest, 1):
            failures += 1
            continue
        planes.append(cells.plane(best))
        left = ~cells.on(planes[-1]) & ~best
        cells = Facets(cells.centre[left], cells.normal[left], cells.tolerance[left])
    return planes


@compiled
def _grown(centre: Floats, normal: Floats, tolerance: Floats, seed: int) -> Bools:
    """Which facets (N,) are on the plane that grows from one of them."""
    # The first step reaches only as far as a single cell's normal is reliable.
    reach, middle, facing = (12 * tolerance[seed]) ** 2, centre[seed].copy(), normal[seed].copy()
    inlier = np.zeros(len(centre), np.bool_)
    for step in range(_ROUNDS + 1):
        changed, total, first = False, 0.0, -1
        sums, mean = np.zeros(3), np.zeros(3)
        for n in range(len(centre)):
            x, y, z = centre[n, 0] - middle[0], centre[n, 1] - middle[1], centre[n, 2] - middle[2]
            on = (
                np.abs(x * facing[0] + y * facing[1] + z * facing[2]) < tolerance[n]
                and normal[n, 0] * facing[0] + normal[n, 1] * facing[1] + normal[n, 2] * facing[2] > _LIKE_CELL
                and (step > 0 or x * x + y * y + z * z < reach)
            )
            changed |= on != inlier[n]
            inlier[n] = on
            if on:
                weight = 1 / tolerance[n] ** 2
                first = n if first < 0 else first
                total += weight
                for i in range(3):
                    mean[i] += weight * centre[n, i]
                    sums[i] += normal[n, i]
        if not changed or step == _ROUNDS or np.count_nonzero(inlier) < 4:
            break
        middle = mean / total
        scatter = np.zeros((3, 3))
        for n in range(len(centre)):
            if inlier[n]:
                off = (centre[n] - middle) / tolerance[n]
                for i in range(3):
                    for j in range(3):
                        scatter[i, j] += off[i] * off[j]
        facing = np.linalg.eigh(scatter)[1][:, 0].copy()
        if np.sum(facing * (centre[first] + sums - middle)) < 0:
            facing = -facing
    return inlier


def _assigned(
    points: NDArray[np.float32], normals: NDArray[np.float32], noise: float, planes: list[Plane]
) -> NDArray[np.int32]:
    """The plane that each pixel (H, W) is nearest to, without pieces that are too small to be one."""
    height, width = points.shape[:2]
    depth = points[..., 2]
    least = (_BENT * depth + np.float32(_SIGMAS * noise) * depth * depth).astype(np.float32)
    labels = np.full((height, width), NO_PLANE, np.int32)
    with np.errstate(invalid="ignore"):
        for label, plane in enumerate(planes):
            normal = plane.normal.astype(np.float32)
            off = np.abs(points @ normal - np.float32(plane.offset))
            nearer = (off < least) & (normals @ normal > _LIKE_PIXEL)
            labels[nearer] = label
            least[nearer] = off[nearer]
    for label in range(len(planes)):
        _part(points, labels, label, planes)
    return _by_size(labels, planes)


def _part(points: NDArray[np.float32], labels: NDArray[np.int32], label: int, planes: list[Plane]) -> None:
    """Remove small pieces of a plane, and separate those in front of or behind its largest.

    Fronts of two cupboards are often nearly coplanar. `labels` and `planes` are changed in place.
    """
    mask = (labels == label).astype(np.uint8)
    count, piece, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA]
    small = area < _LEAST_PIECE * labels.size
    labels[(mask > 0) & small[piece]] = NO_PLANE
    plane = planes[label]
    first = None
    for n in 1 + np.argsort(-area[1:count], kind="stable"):
        if small[n]:
            break
        at = np.flatnonzero(piece.ravel() == n)
        some = points.reshape(-1, 3)[at[:: max(1, len(at) // _FITTED)]].astype(np.float64)
        off = float(np.median(plane.heights(some) / some[:, 2]))
        if first is None:
            first = off
        elif abs(off - first) > _PARTED:
            labels.ravel()[at] = len(planes)
            planes.append(Plane.through(some, 1 / some[:, 2] ** 2))


def _by_size(labels: NDArray[np.int32], planes: list[Plane]) -> NDArray[np.int32]:
    """Planes numbered again, largest first, those that kept no pixels left out; `planes` in place."""
    count: Ints = np.bincount(labels[labels >= 0], minlength=len(planes))
    order = [int(i) for i in np.argsort(-count, kind="stable") if count[i] > 0]
    rank = np.full(len(planes) + 1, NO_PLANE, np.int32)
    rank[order] = np.arange(len(order))
    planes[:] = [planes[i] for i in order]
    return rank[labels]
