"""The surface through a grid of points: normals, and the points that lie on no surface at all.

Almost everywhere a plane through a pixel's window is fitted in inverse depth, with box filters. Where the window
crosses an occlusion edge, or holds too few points, the nearest neighbours in space are used instead: they lie on the
pixel's own side of the edge.

Lengths are judged in footprints: the distance that one pixel's step covers at the point's depth on a surface facing
the camera. That makes them independent of the unit and of the scene's size.
"""

from dataclasses import dataclass
from math import cos, radians

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calib.arrays import Bools, Floats
from calib.parallel import in_slices

_SMALLEST_WINDOW, _LARGEST_WINDOW = 7, 15
_WANTED_NORMAL_RAD = 0.05
_STRIP_ROWS = 32
_NEIGHBOURS = 12
_FEWEST_NEIGHBOURS = 4
# A surface seen at more than 85° from its normal cannot be told from an occlusion edge.
_STEEPEST = 1 / cos(radians(85.0))
_OUTLIER_SIGMAS = 6.0
# Spread of a window's pixels along its narrow side, in px²; a full window has 4, a single row 0.
_NARROWEST = 0.5
_SAMPLE = 200_000


@dataclass(frozen=True)
class Surface:
    """`normals` (H, W, 3): of unit length and facing the camera, NaN where there is no point.

    `isolated` (H, W): points without neighbours on a common surface.
    """

    normals: NDArray[np.float32]
    isolated: Bools


@dataclass(frozen=True)
class _WindowPlanes:
    """Least-squares planes: `normals` (H, W, 3), `roughness` (H, W) in footprints, NaN where there is none."""

    normals: NDArray[np.float32]
    roughness: NDArray[np.float32]
    count: NDArray[np.float32]

    def typical(self, there: Bools) -> tuple[float, float]:
        """The roughness of an ordinary window, in footprints, and how many points it has; of some windows `there`."""
        places = np.flatnonzero(there)
        places = places[:: max(1, len(places) // _SAMPLE)]
        roughness, count = self.roughness.ravel()[places], self.count.ravel()[places]
        fitted = roughness[np.isfinite(roughness)]
        return float(np.median(fitted)) if len(fitted) else 0.0, float(np.median(count))


def surface(points: NDArray[np.float32], focal_px: float) -> Surface:
    """Normals of points (H, W, 3) on the camera's grid, NaN where there is none; `focal_px` is the camera's."""
    there = np.isfinite(points[..., 2])
    isolated = np.zeros(there.shape, dtype=np.bool_)
    if not there.any():
        return Surface(np.full_like(points, np.nan), isolated)
    planes, window = _window_planes(points, focal_px, _SMALLEST_WINDOW), _SMALLEST_WINDOW
    noise, filled = planes.typical(there)
    wider = _window_for(noise, filled)
    if wider > window:
        planes, window = _window_planes(points, focal_px, wider), wider
        noise, filled = planes.typical(there)
    with np.errstate(invalid="ignore"):
        hard = there & ~(planes.roughness <= max(1.0, _OUTLIER_SIGMAS * noise))
    normals = planes.normals
    if hard.any():
        spacing = max(1.0, window / float(np.sqrt(filled)))
        reach = max(_STEEPEST * spacing, _OUTLIER_SIGMAS * noise) * points[hard][:, 2].astype(np.float64) / focal_px
        nearby = cv2.dilate(hard.astype(np.uint8), np.ones((2 * window + 1, 2 * window + 1), np.uint8)) > 0
        normals[hard], isolated[hard] = _neighbour_planes(points[hard], points[nearby & there], reach)
    return Surface(normals, isolated)


def scattered_surface(points: NDArray[np.float32]) -> Surface:
    """The same of points that are too far apart for windows: every one counts, normals come from its neighbours."""
    there = np.isfinite(points[..., 2])
    normals = np.full_like(points, np.nan)
    if there.any():
        scattered = points[there]
        normals[there] = _neighbour_planes(scattered, scattered, np.full(len(scattered), np.inf))[0]
    return Surface(normals, np.zeros(there.shape, dtype=np.bool_))


def _window_for(noise: float, count: float) -> int:
    """The window, odd, in which points this rough give normals good to `_WANTED_NORMAL_RAD`.

    A line through n points spread evenly over w px has a slope that errs by noise √12 / (w √n); `count` is that of the
    smallest window, n grows with w².
    """
    per_side = float(np.sqrt(count)) / _SMALLEST_WINDOW
    width = float(np.sqrt(np.sqrt(12.0) * noise / (_WANTED_NORMAL_RAD * per_side)))
    return int(np.clip(2 * round((width - 1) / 2) + 1, _SMALLEST_WINDOW, _LARGEST_WINDOW))


def _window_planes(points: NDArray[np.float32], focal_px: float, window: int) -> _WindowPlanes:
    """Planes through every pixel's window, strip by strip so that the work stays in the processor's cache."""
    height, halo = len(points), window // 2
    normals = np.full_like(points, np.nan)
    roughness = np.full(points.shape[:2], np.nan, dtype=np.float32)
    count = np.zeros(points.shape[:2], dtype=np.float32)

    def fit(rows: slice) -> None:
        top, bottom = rows.start, rows.stop
        first, last = max(0, top - halo), min(height, bottom + halo)
        strip = _strip_planes(points[first:last], focal_px, window)
        inner = slice(top - first, bottom - first)
        normals[top:bottom] = strip.normals[inner]
        roughness[top:bottom] = strip.roughness[inner]
        count[top:bottom] = strip.count[inner]

    in_slices(height, _STRIP_ROWS, fit)
    return _WindowPlanes(normals, roughness, count)


def _strip_planes(points: NDArray[np.float32], focal_px: float, window: int) -> _WindowPlanes:
    """Planes n·X = 1 are affine in the image, 1/z = n_x x/z + n_y y/z + n_z, and there the noise is uniform."""
    there = np.isfinite(points[..., 2])

    def box(values: Floats) -> Floats:
        """Sum over each pixel's window; zeros outside the image."""
        size = (window, window)
        return np.asarray(cv2.boxFilter(values, cv2.CV_64F, size, normalize=False, borderType=cv2.BORDER_CONSTANT))

    with np.errstate(divide="ignore", invalid="ignore"):
        w = np.where(there, 1.0 / points[..., 2].astype(np.float64), 0.0)
        x, y = (np.where(there, focal_px * points[..., axis] * w, 0.0) for axis in (0, 1))
        count = box(there.astype(np.float64))
        mean_x, mean_y, mean_w = box(x) / count, box(y) / count, box(w) / count
        xx, xy, yy = (
            box(x * x) / count - mean_x**2,
            box(x * y) / count - mean_x * mean_y,
            box(y * y) / count - mean_y**2,
        )
        xw, yw, ww = (
            box(x * w) / count - mean_x * mean_w,
            box(y * w) / count - mean_y * mean_w,
            box(w * w) / count - mean_w**2,
        )
        determinant = xx * yy - xy * xy
        a = (yy * xw - xy * yw) / determinant
        b = (xx * yw - xy * xw) / determinant
        c = mean_w - a * mean_x - b * mean_y
        # A depth error of one footprint, z / f, changes 1/z by 1 / (f z).
        roughness = np.sqrt(np.maximum(ww - a * xw - b * yw, 0.0)) * focal_px / w
        narrow = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        bad = ~there | (count < _FEWEST_NEIGHBOURS + 1) | ~(narrow > _NARROWEST)
        normals = -np.stack([a * focal_px, b * focal_px, c], axis=-1)
        normals /= np.sqrt(np.einsum("...i,...i", normals, normals))[..., None]
    normals[bad] = np.nan
    roughness[bad] = np.nan
    return _WindowPlanes(normals.astype(np.float32), roughness.astype(np.float32), count.astype(np.float32))


def _neighbour_planes(
    points: NDArray[np.float32], cloud: NDArray[np.float32], reach: Floats
) -> tuple[NDArray[np.float32], Bools]:
    """Normals (M, 3) of `points` (M, 3) from their nearest neighbours in `cloud`, and which of them have too few.

    Neighbours farther than `reach` (M,) are on another surface.
    """
    tree = cKDTree(cloud, balanced_tree=False, compact_nodes=False)
    distance, index = tree.query(points, k=_NEIGHBOURS + 1, workers=-1)
    near = (distance <= reach[:, None]).astype(np.float64)
    offsets: Floats = cloud[np.minimum(index, len(cloud) - 1)].astype(np.float64) - points[:, None]
    weight: Floats = near.sum(axis=1)
    mean = np.einsum("mk,mki->mi", near, offsets) / weight[:, None]
    centred = (offsets - mean[:, None]) * near[..., None]
    spread, axes = np.linalg.eigh(np.einsum("mki,mkj->mij", centred, centred))
    toward_camera = -points.astype(np.float64) / np.linalg.norm(points, axis=1, keepdims=True)
    # Points on a line, or alone, have no normal of their own.
    normals: Floats = np.where((spread[:, 1] > 0.01 * spread[:, 2])[:, None], axes[:, :, 0], toward_camera)
    normals *= np.where(np.sum(normals * toward_camera, axis=1) < 0, -1.0, 1.0)[:, None]
    isolated: Bools = weight < _FEWEST_NEIGHBOURS + 1
    return normals.astype(np.float32), isolated
