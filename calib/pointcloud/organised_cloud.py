"""Triangulates matches to an organised point cloud, with at most one point for each camera pixel.

Normals of an organised cloud by local plane fits, and its isolated points.

Usually a plane is fitted through a pixel's window, in inverse depth. Where the window crosses an occlusion edge, or
holds too few points, the nearest neighbours in space are used instead; they lie on the same side of the edge.

Lengths are in footprints: the step of one pixel at the point's depth, on a surface facing the camera. That makes limits
independent of the unit and of the scene's size.
"""

from dataclasses import dataclass
from functools import cached_property
from math import cos, radians

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from calib.geometry import Calibration, Matches
from calib.numerics import Bools, Floats, Image, Ints, in_slices
from calib.pointcloud.pixel_grid import organise
from calib.pointcloud.plane_fit import FEWEST_NEIGHBOURS, LARGEST_WINDOW, WindowPlanes, window_planes

_SMALLEST_WINDOW = 7
_WANTED_NORMAL_RAD = 0.05
_NEIGHBOURS = 12
# A surface seen at more than 85° from its normal cannot be distinguished from an occlusion edge.
_STEEPEST = 1 / cos(radians(85.0))
_OUTLIER_SIGMAS = 6.0
_SAMPLE = 200_000
_AT_A_TIME = 4096
_STRIP_ROWS = 64
_NO_TEXTURE_GREY = 200
_WHITE_PERCENTILE = 99.9


@dataclass(frozen=True)
class SurfaceNormals:
    """`normals` (H, W, 3): of unit length and facing the camera, NaN where there is no point.

    `isolated` (H, W): points without neighbours on a common surface.
    """

    normals: NDArray[np.float32]
    isolated: Bools


def surface(points: NDArray[np.float32], focal_px: float) -> SurfaceNormals:
    """Normals of points (H, W, 3) on the camera's grid, NaN where there is none; `focal_px` is the camera's."""
    planes, window = window_planes(points, focal_px, _SMALLEST_WINDOW), _SMALLEST_WINDOW
    isolated = np.zeros(planes.count.shape, dtype=np.bool_)
    if not planes.count.any():
        return SurfaceNormals(planes.normals, isolated)
    noise, filled = _typical(planes)
    wider = _window_for(noise, filled)
    if wider > window:
        planes, window = window_planes(points, focal_px, wider), wider
        noise, filled = _typical(planes)
    normals, width = planes.normals, points.shape[1]

    def uneven(rows: slice) -> Ints:
        even = planes.roughness[rows] <= max(1.0, _OUTLIER_SIGMAS * noise)
        places: Ints = rows.start * width + np.flatnonzero(~even & (planes.count[rows] > 0))
        return places

    hard = np.concatenate(in_slices(len(points), _STRIP_ROWS, uneven))
    if len(hard):
        spacing, cloud = max(1.0, window / float(np.sqrt(filled))), points.reshape(-1, 3)
        reach = max(_STEEPEST * spacing, _OUTLIER_SIGMAS * noise) * cloud[hard, 2].astype(np.float64) / focal_px
        marked = np.zeros(isolated.shape, np.uint8)
        marked.flat[hard] = 1
        nearby = np.asarray(cv2.dilate(marked, np.ones((2 * window + 1, 2 * window + 1), np.uint8)))
        around = np.flatnonzero(nearby.view(np.bool_))
        around = around[planes.count.ravel()[around] > 0]
        normals.reshape(-1, 3)[hard], isolated.flat[hard] = _neighbour_planes(cloud[hard], cloud[around], reach)
    return SurfaceNormals(normals, isolated)


def scattered_surface(points: NDArray[np.float32]) -> SurfaceNormals:
    """Normals of points (H, W, 3) too sparse for windows, from their nearest neighbours; none counts as isolated."""
    there = np.isfinite(points[..., 2])
    normals = np.full_like(points, np.nan)
    if there.any():
        scattered = points[there]
        normals[there] = _neighbour_planes(scattered, scattered, np.full(len(scattered), np.inf))[0]
    return SurfaceNormals(normals, np.zeros(there.shape, dtype=np.bool_))


def _typical(planes: WindowPlanes) -> tuple[float, float]:
    """The median roughness of windows, in footprints, and their median number of points, from a sample."""
    counts = planes.count.ravel()
    step = max(1, int(np.count_nonzero(counts)) // _SAMPLE)
    places = step * np.flatnonzero(counts[::step] > 0)
    roughness, count = planes.roughness.ravel()[places], counts[places]
    fitted = roughness[np.isfinite(roughness)]
    return float(np.median(fitted)) if len(fitted) else 0.0, float(np.median(count))


def _window_for(noise: float, count: float) -> int:
    """The odd window size at which points this rough give normals accurate to `_WANTED_NORMAL_RAD`.

    A line through n points spread evenly over w px has a slope that errs by noise √12 / (w √n); `count` is that of the
    smallest window, n grows with w².
    """
    per_side = float(np.sqrt(count)) / _SMALLEST_WINDOW
    width = float(np.sqrt(np.sqrt(12.0) * noise / (_WANTED_NORMAL_RAD * per_side)))
    return int(np.clip(2 * round((width - 1) / 2) + 1, _SMALLEST_WINDOW, LARGEST_WINDOW))


def _neighbour_planes(
    points: NDArray[np.float32], cloud: NDArray[np.float32], reach: Floats
) -> tuple[NDArray[np.float32], Bools]:
    """Normals (M, 3) of `points` (M, 3) from their nearest neighbours in `cloud`, and which points have too few (M,).

    Neighbours farther than `reach` (M,) are on another surface.
    """
    tree = scipy.spatial.cKDTree(cloud, balanced_tree=False, compact_nodes=False)
    fitted = in_slices(len(points), _AT_A_TIME, lambda at: _fit_to_neighbours(tree, points[at], cloud, reach[at]))
    normals, isolated = map(np.concatenate, zip(*fitted, strict=True))
    return normals, isolated


def _fit_to_neighbours(
    tree: "scipy.spatial.cKDTree", points: NDArray[np.float32], cloud: NDArray[np.float32], reach: Floats
) -> tuple[NDArray[np.float32], Bools]:
    distance, index = tree.query(points, k=_NEIGHBOURS + 1)
    near = (distance <= reach[:, None]).astype(np.float64)
    offsets: Floats = cloud[np.minimum(index, len(cloud) - 1)].astype(np.float64) - points[:, None]
    weight: Floats = near.sum(axis=1)
    mean = np.einsum("mk,mki->mi", near, offsets) / np.maximum(weight, 1.0)[:, None]  # no neighbours within reach
    centred = (offsets - mean[:, None]) * near[..., None]
    spread, axes = np.linalg.eigh(np.matmul(centred.transpose(0, 2, 1), centred))
    toward_camera = -points.astype(np.float64) / np.linalg.norm(points, axis=1, keepdims=True)
    # Points on a line, or single ones, have no normal; they get the direction to the camera.
    normals: Floats = np.where((spread[:, 1] > 0.01 * spread[:, 2])[:, None], axes[:, :, 0], toward_camera)
    normals *= np.where(np.sum(normals * toward_camera, axis=1) < 0, -1.0, 1.0)[:, None]
    isolated: Bools = weight < FEWEST_NEIGHBOURS + 1
    return normals.astype(np.float32), isolated


@dataclass(frozen=True)
class CloudStatistics:
    """Counts of matches: `matched` is the sum of `kept` and all that were dropped."""

    matched: int
    kept: int
    outside_image: int
    """Off the camera's grid."""
    behind: int
    """Not in front of both devices."""
    disagreeing: int
    """The rays miss each other by more than `limit_px`."""
    shared_pixel: int
    """Another match of the same camera pixel fitted better."""
    isolated: int
    """No neighbours on a common surface."""
    limit_px: float
    calibration_px: float
    """Root mean square of the smooth part of the rays' misses, in projector pixels."""
    decoder_px: float
    """Root mean square of the rest of them, in projector pixels."""


@dataclass(frozen=True)
class Cloud:
    """Points on the camera's pixel grid, in the camera's frame (x right, y down, z forward)."""

    points: NDArray[np.float32]
    """In `unit`, NaN where there is none, (H, W, 3)."""
    colours: NDArray[np.uint8]
    """RGB, (H, W, 3)."""
    normals: NDArray[np.float32]
    """Of unit length and facing the camera, (H, W, 3)."""
    residual_px: NDArray[np.float32]
    """Signed distance of the projector pixel from the camera pixel's epipolar line, also where the point was dropped
    for it, NaN where there was no match, (H, W).
    """
    match: NDArray[np.int32]
    """Number of the match that each point was triangulated from, of no meaning where there is none, (H, W)."""
    unit: str
    statistics: CloudStatistics

    @cached_property
    def there(self) -> Bools:
        """Which pixels have a point, (H, W)."""
        return np.isfinite(self.points[..., 2])


def build_cloud(matches: Matches, texture: Image | None, calibration: Calibration, *, scattered: bool = False) -> Cloud:
    """Triangulate every match, drop those that are not points of a surface, add colours and normals.

    `texture`: the camera's image of the lit scene, (H, W) grey or (H, W, 3) BGR; without it the cloud is grey.
    `scattered`: matches are sparse, so points without neighbours are kept.

    Raises ValueError if the texture's size is not the camera's.
    """
    height, width = calibration.camera.height, calibration.camera.width
    if texture is not None and texture.shape[:2] != (height, width):
        size = f"{texture.shape[1]} × {texture.shape[0]}"
        raise ValueError(f"the texture must have the camera's size {width} × {height}, found {size}")
    organised = organise(matches, calibration)
    points = organised.points
    on_surface = (
        scattered_surface(points) if scattered else surface(points, float(np.mean(calibration.camera.focal_px)))
    )
    isolated = np.flatnonzero(on_surface.isolated)
    points.reshape(-1, 3)[isolated] = np.nan
    on_surface.normals.reshape(-1, 3)[isolated] = np.nan
    dropped = {
        "outside_image": organised.outside_image,
        "behind": organised.behind,
        "disagreeing": organised.disagreeing,
        "shared_pixel": organised.shared_pixel,
        "isolated": len(isolated),
    }
    there = np.empty((height, width), np.bool_)
    in_slices(height, _STRIP_ROWS, lambda rows: np.isfinite(points[rows, :, 2], out=there[rows]))
    return Cloud(
        points=points,
        colours=colours_of(texture, there),
        normals=on_surface.normals,
        residual_px=organised.residual_px,
        match=organised.match,
        unit=calibration.unit,
        statistics=CloudStatistics(
            matched=len(matches),
            kept=len(matches) - sum(dropped.values()),
            **dropped,
            limit_px=organised.misses.limit_px,
            calibration_px=organised.trend_px,
            decoder_px=organised.misses.noise_px,
        ),
    )


def colours_of(texture: Image | None, there: Bools) -> NDArray[np.uint8]:
    """RGB (H, W, 3) of a camera's image, (H, W) or (H, W, 3) BGR; black where there is no point. 16-bit images are
    scaled to their 99.9 % percentile.
    """
    if texture is None:
        bright = np.full(there.shape, _NO_TEXTURE_GREY, dtype=np.uint8)
    elif texture.dtype == np.uint16:
        top = max(1.0, float(np.percentile(texture[there], _WHITE_PERCENTILE))) if there.any() else 1.0
        levels = np.arange(1 << 16) * (255.0 / top)
        bright = np.rint(np.minimum(levels, 255.0)).astype(np.uint8)[texture]
    else:
        bright = texture.astype(np.uint8, copy=False)
    order, rgb = cv2.COLOR_BGR2RGB if bright.ndim == 3 else cv2.COLOR_GRAY2RGB, np.zeros((*there.shape, 3), np.uint8)
    mask = there.view(np.uint8)
    in_slices(len(rgb), _STRIP_ROWS, lambda rows: cv2.copyTo(cv2.cvtColor(bright[rows], order), mask[rows], rgb[rows]))
    return rgb
