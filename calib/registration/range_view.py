"""A station for the registration: a small picture of depths by an ideal camera, and patches of its surfaces.

The picture has no lens distortion and no more pixels than needed; its points are measured ones. A patch is one point
per unit of surface area, near and far.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics, Plane
from calib.numerics import Floats, Ints
from calib.registration.keypoints import Keypoints, no_keypoints
from calib.registration.projection import Patches, RangeImage
from calib.registration.segments import find_segments, relative_noise


@dataclass(frozen=True, eq=False)
class StationView:
    """An organised cloud in its camera's frame, with its planes.

    `points`, `normals` (H, W, 3), NaN for none; `labels` (H, W): index into `planes` of each pixel, −1 for none.
    `noise`: standard deviation of a point along its ray at depth z is `noise` · z². `keypoints`: of its picture on the
    planes, empty without a picture.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    labels: NDArray[np.int32]
    planes: tuple[Plane, ...]
    camera: Intrinsics
    noise: float
    keypoints: Keypoints = field(default_factory=no_keypoints)


def station_view(points: NDArray[np.float32], normals: NDArray[np.float32], camera: Intrinsics) -> StationView:
    """With planes found and noise measured; arguments as of `StationView`.

    Raises ValueError if the arrays do not have the size of the camera's image.
    """
    shape = (camera.height, camera.width, 3)
    if points.shape != shape or normals.shape != shape:
        raise ValueError(f"points and normals must have the shape {shape}, found {points.shape} and {normals.shape}")
    noise = relative_noise(points, normals)
    labels, planes = find_segments(points, normals, noise)
    return StationView(points, normals, labels, planes, camera, noise)


_COLUMNS = 306
# Pixels: error of unrefined poses, and uncertainty of the edges of things.
_AROUND = 7
_PATCHES = 1500
_STEEPEST = 0.1  # cosine of the slant beyond which a patch's area is unreliable


@dataclass(frozen=True, eq=False)
class Surfaces:
    """What a registration compares of a station with planes."""

    image: RangeImage
    """Of a pinhole camera (h, w); all NaN where nothing was measured."""
    labels: Ints
    """(h, w): as in the view."""
    patches: Patches
    """M of them, in random order."""
    patch_labels: Ints
    """(M,)"""
    planes: Floats
    """(P, 4): normals and offsets."""
    plane_area: Ints
    """(P,): patches on each."""
    noise: float
    """As of the view."""
    distance: float
    """Median depth."""
    keypoints: Keypoints
    """Of the picture."""


def surfaces_of(view: StationView) -> Surfaces:
    """Raises ValueError for a view without points."""
    if not np.isfinite(view.points[..., 2]).any():
        raise ValueError("a station needs points, found none")
    focal_px, centre_px, row, column = _pinhole_grid(view)
    points = view.points[row, column].astype(np.float64)
    normals = view.normals[row, column].astype(np.float64)
    missing = ~np.isfinite(points[..., 2]) | ~np.isfinite(normals[..., 2]) | (row < 0)
    points[missing] = np.nan
    normals[missing] = np.nan
    labels = np.where(missing, -1, view.labels[row, column]).astype(np.int32)
    depth = points[..., 2]
    near = cv2.erode(np.where(missing, np.inf, depth), np.ones((_AROUND, _AROUND), np.uint8))
    chosen = sample_evenly(points, normals, _PATCHES, _STEEPEST, beyond=True)
    flat = points.reshape(-1, 3)
    patch_labels = labels.ravel()[chosen]
    planes = np.array([[*plane.normal, plane.offset] for plane in view.planes]).reshape(-1, 4)
    lens = np.array([focal_px, focal_px, *centre_px, 0, 0, 0, 0, 0], np.float64)
    return Surfaces(
        RangeImage(points, normals, np.ascontiguousarray(depth), np.where(missing, np.nan, near), lens),
        labels,
        Patches(flat[chosen], normals.reshape(-1, 3)[chosen]),
        patch_labels,
        planes,
        np.bincount(patch_labels[patch_labels >= 0], minlength=len(planes)),
        view.noise,
        float(np.nanmedian(depth)),
        view.keypoints,
    )


def _pinhole_grid(view: StationView) -> tuple[float, tuple[float, float], Ints, Ints]:
    """An ideal camera with few pixels that covers the points of a view.

    Returns focal length, centre, and for each of its pixels the row and column (h, w) of the nearest pixel in the view;
    −1 for none.
    """
    camera, there = view.camera, np.isfinite(view.points[..., 2])
    rows, columns = np.flatnonzero(there.any(axis=1)), np.flatnonzero(there.any(axis=0))
    x, y = np.meshgrid(np.linspace(columns[0], columns[-1], 33), np.linspace(rows[0], rows[-1], 33))
    border = camera.unproject(np.stack([x, y], axis=-1))[..., :2].reshape(-1, 2)
    border = border[np.isfinite(border[:, 0])]
    low, high = border.min(axis=0), border.max(axis=0)
    focal_px = float(min(_COLUMNS / np.max(high - low), np.mean(camera.focal_px)))
    width, height = (int(np.ceil(extent * focal_px)) + 1 for extent in high - low)
    u, v = np.meshgrid(np.arange(width) / focal_px + low[0], np.arange(height) / focal_px + low[1])
    pixels = camera.project(np.stack([u, v, np.ones_like(u)], axis=-1))
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5), axis=-1)
    column, row = np.rint(np.where(inside[..., None], pixels, -1)).astype(np.int64).transpose(2, 0, 1)
    return focal_px, (float(-low[0] * focal_px), float(-low[1] * focal_px)), row, column


def sample_evenly(
    points: NDArray[np.floating], normals: NDArray[np.floating], count: int, steepest: float, *, beyond: bool
) -> Ints:
    """Up to `count` pixels, as flat indices in random order, drawn evenly over the surfaces (H, W, 3).

    Those whose slant has a smaller cosine than `steepest` count as if it were that, or are left out unless `beyond`.
    """
    flat, towards = points.reshape(-1, 3), normals.reshape(-1, 3)
    there = np.flatnonzero(np.isfinite(flat[:, 2]))
    visible = flat[there].astype(np.float64)
    slant = np.abs(np.sum(visible * towards[there], axis=1)) / np.linalg.norm(visible, axis=1)
    kept = beyond | (slant > steepest)
    there, depth = there[kept], visible[kept, 2]
    area = np.cumsum(depth**2 / np.maximum(slant[kept], steepest))
    rng = np.random.default_rng(0)
    places = (np.arange(count) + rng.random(count)) / count * area[-1]
    chosen: Ints = there[np.unique(np.minimum(np.searchsorted(area, places), len(there) - 1))]
    return rng.permutation(chosen)
