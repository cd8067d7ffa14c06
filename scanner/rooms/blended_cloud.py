"""All stations' points in one cloud: thinned by voxels, in each of which the points of several stations are blended."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Calibration
from calib.numerics import Bools, Ints
from calib.pointcloud import NONE, MergedCloud, density
from scanner.exporting.open3d_module import open3d
from scanner.rooms.contents import SolvedRoom, Station
from scanner.rooms.denoised import denoised

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
        normals = station.cloud.normals[there].astype(np.float64) @ station.place.rotation.T
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
        tuple(np.column_stack([each.place.rotation, each.place.translation]) for each in stations),
    )
