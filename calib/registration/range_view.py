"""A station for the registration: its planes, a small picture of depths by an ideal camera, and patches of surface.

The picture has no lens distortion and no more pixels than needed; its points are measured ones. A patch is one point
per unit of surface area, near and far.

A plane's matches follow a homography, whatever the calibration. With an approximate rig, a segment may contain nearly
coplanar surfaces, such as two cupboards side by side. Matches that a homography with lens distortion does not explain
are removed; they form another plane if there are enough.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.estimation import follow_one_plane
from calib.geometry import Calibration, Intrinsics, Matches, Plane, TooFewMatchesError
from calib.numerics import Bools, Floats, Ints, evenly
from calib.registration.keypoints import Keypoints, no_keypoints
from calib.registration.projection import Patches, RangeImage
from calib.registration.segments import NO_PLANE, find_segments, relative_noise


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


_LEAST_MATCHES, _LEAST_SHARE = 200, 0.02  # share of a station's matches on planes
_MOST_PIECES = 3
_LEAST_OFF_PX = 0.1  # projector pixels left by an approximate lens
_FITTED = 4000


def split_planes(view: StationView, matches: Matches, calibration: Calibration) -> tuple[StationView, Ints]:
    """The view with straight planes, and the plane of each match (N,), −1 for none.

    `calibration`: an approximate rig; only its lens distortion is used.
    """
    ideal, known = _undistorted(matches, calibration)
    height, width = view.labels.shape
    column, row = np.rint(matches.camera_px).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    pixel = np.where(inside, row * width + column, 0)
    plane = np.where(inside & known, view.labels.ravel()[pixel], NO_PLANE)
    straight = np.full(len(matches), NO_PLANE, np.int32)
    fewest = max(_LEAST_MATCHES, int(_LEAST_SHARE * np.count_nonzero(plane != NO_PLANE)))
    count = 0
    for label in range(len(view.planes)):
        remaining = np.flatnonzero(plane == label)
        least = min(fewest, max(_LEAST_MATCHES, len(remaining) // 2))  # the segment may be small
        for _ in range(_MOST_PIECES):
            if len(remaining) < least:
                break
            try:
                on = follow_one_plane(ideal[remaining], _LEAST_OFF_PX)
            except TooFewMatchesError:
                break
            if np.count_nonzero(on) >= least:
                straight[remaining[on]] = count
                count += 1
            remaining, least = remaining[~on], fewest
    labels = np.full(height * width, NO_PLANE, np.int32)
    there = inside & (straight != NO_PLANE)
    labels[pixel[there]] = straight[there]
    labels[~np.isfinite(view.points[..., 2]).ravel()] = NO_PLANE
    return _with_labels(view, labels.reshape(height, width), straight, count)


def _undistorted(matches: Matches, calibration: Calibration) -> tuple[Matches, Bools]:
    """The same matches in devices of the same focal lengths without distortion, and which of them (N,) have a place."""
    camera_px, projector_px = (
        Intrinsics(device.width, device.height, device.focal_px, device.principal_point_px).project(
            device.unproject(pixels.astype(np.float64))
        )
        for device, pixels in ((calibration.camera, matches.camera_px), (calibration.projector, matches.projector_px))
    )
    known: Bools = np.asarray(np.isfinite(np.hstack([camera_px, projector_px])).all(axis=1), np.bool_)
    camera_px[~known], projector_px[~known] = 0.0, 0.0
    return Matches(camera_px, projector_px, None, matches.sigma_px), known


def _with_labels(view: StationView, labels: Ints, straight: Ints, count: int) -> tuple[StationView, Ints]:
    """With planes through the points of each label; labels without points are left out."""
    planes: list[Plane] = []
    renumbered = np.full(count + 1, NO_PLANE, np.int32)
    flat = view.points.reshape(-1, 3)
    for label in range(count):
        own = evenly(labels.ravel() == label, _FITTED)
        if len(own) < 3:
            continue
        renumbered[label] = len(planes)
        points = flat[own].astype(np.float64)
        planes.append(Plane.through(points, 1 / points[:, 2] ** 2))
    return replace(view, labels=renumbered[labels], planes=tuple(planes)), renumbered[straight]
