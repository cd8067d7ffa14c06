"""A station for the registration: a small picture of depths by an ideal camera, and patches of its surfaces.

The picture has no lens distortion and no more pixels than needed; its points are measured ones. A patch is one point
per unit of surface area, near and far.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Intrinsics, Plane
from calib.numerics import Floats, Ints, compiled
from calib.registration.keypoints import Keypoints, no_keypoints
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


@compiled
def rotate_vector(r: Floats, vector: Floats) -> tuple[float, float, float]:
    """R (3, 3) times a vector (3,), without an array for the result."""
    a, b, c = vector[0], vector[1], vector[2]
    return (
        r[0, 0] * a + r[0, 1] * b + r[0, 2] * c,
        r[1, 0] * a + r[1, 1] * b + r[1, 2] * c,
        r[2, 0] * a + r[2, 1] * b + r[2, 2] * c,
    )


@compiled
def pixel_under(x: float, y: float, z: float, lens: Floats, height: int, width: int) -> tuple[int, int]:
    """Row and column that a point in the camera's frame falls on; (−1, −1) outside the picture or behind the camera."""
    if not z > 1e-9:
        return -1, -1
    u, v = x / z, y / z
    q = u * u + v * v
    radial = 1 + q * (lens[4] + q * (lens[5] + q * lens[8]))
    across = u * radial + 2 * lens[6] * u * v + lens[7] * (q + 2 * u * u)
    down = v * radial + lens[6] * (q + 2 * v * v) + 2 * lens[7] * u * v
    column, row = np.floor(lens[0] * across + lens[2] + 0.5), np.floor(lens[1] * down + lens[3] + 0.5)
    if not (0 <= column < width and 0 <= row < height):
        return -1, -1
    return int(row), int(column)


_COLUMNS = 306
# Pixels: error of unrefined poses, and uncertainty of the edges of things.
_AROUND = 7
_PATCHES = 1500
_STEEPEST = 0.1  # cosine of the slant beyond which a patch's area is unreliable


@dataclass(frozen=True, eq=False)
class Surfaces:
    """`points`, `normals` (h, w, 3), `labels` (h, w) as in the view, on the grid of a pinhole camera with `focal_px`
    and `centre_px`; `near` (h, w): least depth around each pixel. All NaN where nothing was
    measured. `patches`, `patch_normals` (M, 3), `patch_labels` (M,), in random order. `planes` (P, 4): normals and
    offsets, `plane_area` (P,): patches on each. `distance`: median depth. `keypoints`: of the picture.
    """

    points: Floats
    normals: Floats
    labels: Ints
    near: Floats
    focal_px: float
    centre_px: tuple[float, float]
    patches: Floats
    patch_normals: Floats
    patch_labels: Ints
    planes: Floats
    plane_area: Ints
    noise: float
    distance: float
    keypoints: Keypoints

    @property
    def lens(self) -> Floats:
        """Of the pinhole camera (9,), as `calib.registration.range_view` reads it."""
        return np.array([self.focal_px, self.focal_px, *self.centre_px, 0, 0, 0, 0, 0], np.float64)


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
    return Surfaces(
        points,
        normals,
        labels,
        np.where(missing, np.nan, near),
        focal_px,
        centre_px,
        flat[chosen],
        normals.reshape(-1, 3)[chosen],
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
