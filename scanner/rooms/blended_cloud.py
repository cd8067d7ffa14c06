"""All stations' points in one cloud: thinned by voxels, within each of which what several stations saw is blended."""

from collections.abc import Sequence

import numpy as np

from calib.geometry import Calibration
from calib.pointcloud import MergedCloud
from scanner.rooms.contents import SolvedRoom, Station
from scanner.rooms.open3d_module import open3d

_VOXEL_PX = 2.0  # camera pixels at the median distance


def grid_of(stations: Sequence[Station], calibration: Calibration) -> float:
    """Edge of a voxel: what a few camera pixels see at the median distance."""
    depths = np.concatenate([station.cloud.points[..., 2][station.cloud.there][::100] for station in stations])
    return _VOXEL_PX * float(np.median(depths)) / float(np.mean(calibration.camera.focal_px))


def blended(room: SolvedRoom) -> MergedCloud:
    """In the room's frame; at most one point in each voxel: the mean of those in it, of its normals and colours."""
    o3d = open3d()
    together = o3d.geometry.PointCloud()
    grid = grid_of(room.stations, room.calibration)
    for station in room.stations:
        own = o3d.geometry.PointCloud()
        there = station.cloud.there
        points = station.to_room(station.cloud.points[there].astype(np.float64))
        own.points = o3d.utility.Vector3dVector(points)
        normals = station.cloud.normals[there].astype(np.float64) @ station.place.rotation.T
        own.normals = o3d.utility.Vector3dVector(normals)
        own.colors = o3d.utility.Vector3dVector(station.cloud.colours[there] / 255.0)
        # Each by itself first, so that memory is that of one station; then the stations with each other.
        together += own.voxel_down_sample(grid / 2)
    thinned = together.voxel_down_sample(grid)
    normals = np.asarray(thinned.normals)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colours = np.rint(255 * np.asarray(thinned.colors)).astype(np.uint8)
    return MergedCloud(
        np.asarray(thinned.points).astype(np.float32),
        colours,
        normals.astype(np.float32),
        room.unit,
        grid,
        (),
        tuple(np.column_stack([each.place.rotation, each.place.translation]) for each in room.stations),
    )
