"""A scan's cloud before its result is there: some of the points that are being written into its file."""

from collections.abc import Iterator

import numpy as np

from calib.geometry import IDENTITY, Pose
from scanner.rendering import photograph
from scanner.results import Reconstructed, Scan
from scanner.viewing.decimation import DEFAULT_SHOWN, shuffled
from scanner.viewing.result import PlacedRig, ViewedCloud


def preview_scan(scan: Scan) -> tuple[ViewedCloud, int]:
    """Return at most `DEFAULT_SHOWN` points of the result's first cloud, and how many points it has.

    This is the merged cloud, or that of the newest capture. It has no corner yet: the faces are still being measured.
    """
    merged, newest = scan.merged, scan.newest
    if merged is not None:
        chosen = _chosen(len(merged.points))
        points = merged.points[chosen].astype(np.float64)
        up = np.array([0.0, 0.0, 1.0 if np.median(points[:, 2]) >= 0 else -1.0])
        poses = zip(scan.captures[::-1], merged.from_cameras[::-1], strict=True)
        rigs = tuple(rig for capture, pose in poses for rig in _rig(capture, pose))
        some = ViewedCloud(
            points, merged.normals[chosen], merged.colours[chosen], rigs, None, up, merged.unit, "corner"
        )
        return some, len(merged.points)
    cloud = newest.cloud
    there = np.flatnonzero(cloud.there)
    chosen = there[_chosen(len(there))]
    points, normals, colours = (
        values.reshape(-1, 3)[chosen] for values in (cloud.points, cloud.normals, cloud.colours)
    )
    rigs = tuple(_rig(newest, IDENTITY))
    up = np.array([0.0, -1.0, 0.0])
    return ViewedCloud(points.astype(np.float64), normals, colours, rigs, None, up, cloud.unit, "camera"), len(there)


def _chosen(count: int) -> np.ndarray:
    """The points that the result shows first, too."""
    return np.sort(shuffled(count)[:DEFAULT_SHOWN])


def _rig(capture: Reconstructed, pose: Pose) -> Iterator[PlacedRig]:
    """The devices in the cloud's frame, by the pose of the camera in it; none without the camera's white picture."""
    texture = capture.decoded.texture
    if texture is not None:
        yield PlacedRig(capture.calibration, pose, photograph(texture))
