"""All stations' points in one cloud: thinned by voxels, in each of which the points of several stations are blended.

Before, the deviations of a station's points from their plane are filtered in the image: each is moved to the mean of
its neighbours as far as their variance is that of noise (Lee, "Digital image enhancement and noise filtering by use of
local statistics", IEEE PAMI 2, 1980). So bent walls stay bent, and relief above the
noise stays. The filter works on inverse depth, where the noise of triangulation does not depend on the distance.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration
from calib.numerics import Bools, Floats, Ints
from calib.pointcloud import NONE, MergedCloud, density
from scanner.exporting import open3d
from scanner.rooms.contents import SolvedRoom, Station

_WINDOW = 7  # pixels
_FEWEST = 12  # points of the plane in a window
_SLACK = 1.5  # factor on the noise variance, which a small window estimates roughly


def denoised(room: SolvedRoom, station: Station) -> NDArray[np.float32]:
    """The station's points (H, W, 3) in the camera's frame; those on no plane are unchanged."""
    points, there = station.cloud.points.copy(), station.cloud.there
    for number in np.unique(station.plane[there & (station.plane >= 0)]):
        on = there & (station.plane == number)
        around = cv2.boundingRect(on.view(np.uint8))
        part = slice(around[1], around[1] + around[3]), slice(around[0], around[0] + around[2])
        plane, place = room.planes[int(number)], station.place
        offset = plane.offset_from(place.translation)
        points[part][on[part]] = _smoothed(points[part], on[part], place.rotation.T @ plane.normal / offset)
    return points


def _smoothed(points: NDArray[np.float32], on: Bools, plane: Floats) -> Floats:
    """The points that are `on` a plane X · `plane` = 1, (N, 3), of a part of an image, (h, w, 3)."""
    depth = np.where(on, points[..., 2], 1.0).astype(np.float64)
    rays = np.where(on[..., None], points, 0.0) / depth[..., None]
    of_plane = rays @ plane
    deviation = np.where(on, 1 / depth - of_plane, 0.0)
    count = _summed(on.astype(np.float64))
    several = np.maximum(count, 2.0)
    mean = _summed(deviation) / several
    variance = np.maximum(_summed(deviation**2) / several - mean**2, 0.0) * several / (several - 1)
    supported = on & (count >= _FEWEST)
    if supported.any():
        noise = _SLACK * float(np.median(variance[supported]))
        kept = np.where(supported, np.clip(1 - noise / np.maximum(variance, noise), 0.0, 1.0), 1.0)
        deviation = mean + kept * (deviation - mean)
    inverse = np.where(supported, of_plane + deviation, 1 / depth)
    return (rays / inverse[..., None])[on]


def _summed(values: Floats) -> Floats:
    """Over the window around each pixel."""
    window = (_WINDOW, _WINDOW)
    return cv2.boxFilter(values, cv2.CV_64F, window, normalize=False, borderType=cv2.BORDER_CONSTANT).astype(np.float64)


_VOXEL_PX = 2.0  # camera pixels at the median distance
_LEAST_DENSITY = 0.01  # points per pixel


def grid_of(stations: Sequence[Station], calibration: Calibration) -> float:
    """Edge of a voxel: the span of a few camera pixels at the median distance, larger for sparse points."""
    depths = np.concatenate([station.cloud.points[..., 2][station.cloud.there][::100] for station in stations])
    spacing = max(spacing_px(station.cloud.there) for station in stations)
    return spacing * _VOXEL_PX * float(np.median(depths)) / float(np.mean(calibration.camera.focal_px))


def spacing_px(there: Bools) -> float:
    """How far neighbouring points of an image (H, W) are apart; 1 where every pixel has one."""
    return 1 / float(np.sqrt(max(density(index_of(there)), _LEAST_DENSITY)))


def index_of(there: Bools) -> Ints:
    """The index of each pixel (H, W) with a point, NONE for others."""
    return np.where(there, np.arange(there.size).reshape(there.shape), NONE)


def blended(room: SolvedRoom) -> MergedCloud:
    """The room's, as `blended_of` makes it."""
    return blended_of(room.stations, room.calibration, [denoised(room, station) for station in room.stations])


def blended_of(
    stations: Sequence[Station], calibration: Calibration, clouds: Sequence[NDArray[np.float32]]
) -> MergedCloud:
    """Of the stations' points (H, W, 3), each in its camera's frame.

    In the room's frame; at most one point in each voxel: the mean of those in it, of its normals and colours.
    """
    o3d = open3d()
    together = o3d.geometry.PointCloud()
    grid = grid_of(stations, calibration)
    for station, cloud in zip(stations, clouds, strict=True):
        own = o3d.geometry.PointCloud()
        there = station.cloud.there
        points = station.to_room(cloud[there].astype(np.float64))
        own.points = o3d.utility.Vector3dVector(points)
        normals = station.place.rotate(station.cloud.normals[there].astype(np.float64))
        own.normals = o3d.utility.Vector3dVector(normals)
        own.colors = o3d.utility.Vector3dVector(station.cloud.colours[there] / 255.0)
        # Each station first by itself, to limit memory; then all together.
        together += own.voxel_down_sample(grid / 2)
    thinned = together.voxel_down_sample(grid)
    normals = np.asarray(thinned.normals)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colours = np.rint(255 * np.asarray(thinned.colors)).astype(np.uint8)
    return MergedCloud(
        np.asarray(thinned.points).astype(np.float32),
        colours,
        normals.astype(np.float32),
        calibration.unit,
        grid,
        (),
        tuple(station.place for station in stations),
    )
