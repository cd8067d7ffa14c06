"""Merges the clouds of several captures in the frame of their common corner, and keeps one point in each voxel."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Pose
from calib.numerics import Bools, Floats, Ints, compiled, in_pieces
from calib.pointcloud.corner_registration import CornerView
from calib.pointcloud.organised_cloud import Cloud

_INDEX_BITS = 32
_INDEX, _TAG = (1 << _INDEX_BITS) - 1, (1 << 31) - 1
# Teschner et al., "Optimized spatial hashing", 2003; and 2⁶⁴ over the golden ratio, as a signed number (Knuth).
_PRIMES = (73856093, 19349663, 83492791)
_GOLDEN = -7046029254386353131


@dataclass(frozen=True)
class MergedCloud:
    """Points in the corner's frame: origin at the vertex, axes along the legs, z along the most upright one."""

    points: NDArray[np.float32]
    """In `unit`, (N, 3)."""
    colours: NDArray[np.uint8]
    """RGB, (N, 3)."""
    normals: NDArray[np.float32]
    """Facing the camera that saw the point, (N, 3)."""
    unit: str
    grid: float
    """Edge of the voxels, which hold at most one point each."""
    turns: tuple[int, ...]
    """For each capture, as in `View.in_corner`."""
    from_cameras: tuple[Pose, ...]
    """For each capture the pose of its camera."""


def merged(clouds: Sequence[Cloud], views: Sequence[CornerView], turns: tuple[int, ...]) -> MergedCloud:
    """Merge clouds in the corner's frame. Of the points in a voxel the one nearest to its camera is kept.

    The grid's edge is the distance between neighbouring camera pixels at the captures' median distance.
    """
    pixels = [np.flatnonzero(cloud.there) for cloud in clouds]
    ends = np.cumsum([len(pixel) for pixel in pixels])
    points, distance = np.empty((ends[-1], 3)), np.empty(ends[-1])
    for cloud, view, turn, pixel, end in zip(clouds, views, turns, pixels, ends, strict=True):
        own = slice(end - len(pixel), end)
        _place(cloud, view, turn, pixel, points[own], distance[own])
    grid = float(np.median([view.distance / np.mean(view.camera.focal_px) for view in views]))
    kept = nearest_in_voxels(points, distance, grid)
    normals, colours = np.empty((len(kept), 3), np.float32), np.empty((len(kept), 3), np.uint8)
    for cloud, view, turn, pixel, end in zip(clouds, views, turns, pixels, ends, strict=True):
        first = end - len(pixel)
        own = slice(*np.searchsorted(kept, (first, end)))
        _fill_attributes(cloud, view, turn, pixel.take(kept[own] - first), normals[own], colours[own])
    return MergedCloud(
        points.take(kept, axis=0).astype(np.float32),
        colours,
        normals,
        clouds[0].unit,
        grid,
        turns,
        tuple(_pose(view, turn) for view, turn in zip(views, turns, strict=True)),
    )


def _place(cloud: Cloud, view: CornerView, turn: int, pixel: Ints, points: Floats, distance: Floats) -> None:
    """Write the points (N, 3) of a cloud's pixels (N,) in the corner's frame, and their distances (N,)."""
    camera_points = cloud.points.reshape(-1, 3)

    def fill(at: slice) -> None:
        in_camera = camera_points.take(pixel[at], axis=0).astype(np.float64)
        points[at] = view.in_corner(in_camera, turn)
        distance[at] = np.linalg.norm(in_camera, axis=1)

    in_pieces(len(pixel), fill)


def _fill_attributes(
    cloud: Cloud, view: CornerView, turn: int, pixel: Ints, normals: NDArray[np.float32], colours: NDArray[np.uint8]
) -> None:
    """Write the normals (N, 3), in the corner's frame, and the colours (N, 3) of a cloud's pixels (N,)."""
    facing, painted = cloud.normals.reshape(-1, 3), cloud.colours.reshape(-1, 3)

    def fill(at: slice) -> None:
        normals[at] = np.roll(facing.take(pixel[at], axis=0) @ view.axes.T, turn, axis=1)
        colours[at] = painted.take(pixel[at], axis=0)

    in_pieces(len(pixel), fill)


def _pose(view: CornerView, turn: int) -> Pose:
    """Of a view's camera in the corner's frame."""
    moved = view.in_corner(np.vstack([np.zeros(3), np.eye(3)]), turn)
    return Pose((moved[1:] - moved[0]).T, moved[0])


def nearest_in_voxels(points: Floats, distance: Floats, size: float) -> Ints:
    """The sorted indices (M,) of the points with the least `distance` (N,) in each voxel with edges of `size`.

    Points (N, 3) must be finite, at most 2³². Of equally near ones the first is kept.
    """
    slots = np.zeros(1 << int(np.ceil(np.log2(1.5 * len(points) + 1))), np.int64)
    _enter(points, distance, size, slots)
    kept = np.zeros(len(points), np.bool_)
    _mark(slots, kept)
    return np.flatnonzero(kept)


@compiled
def _enter(points: Floats, distance: Floats, size: float, slots: Ints) -> None:
    """Insert points into a hash table with open addressing. A slot holds a tag and a point's index from 1, or 0."""
    last = len(slots) - 1
    for i in range(len(points)):
        x, y, z = np.floor(points[i, 0] / size), np.floor(points[i, 1] / size), np.floor(points[i, 2] / size)
        mixed = ((int(x) * _PRIMES[0]) ^ (int(y) * _PRIMES[1]) ^ (int(z) * _PRIMES[2])) * _GOLDEN
        slot, tag = (mixed >> _INDEX_BITS) & last, mixed & _TAG
        while slots[slot] != 0:
            member = (slots[slot] & _INDEX) - 1
            if slots[slot] >> _INDEX_BITS == tag and (
                x == np.floor(points[member, 0] / size)
                and y == np.floor(points[member, 1] / size)
                and z == np.floor(points[member, 2] / size)
            ):
                break
            slot = (slot + 1) & last
        if slots[slot] == 0 or distance[i] < distance[(slots[slot] & _INDEX) - 1]:
            slots[slot] = (tag << _INDEX_BITS) | (i + 1)


@compiled
def _mark(slots: Ints, kept: Bools) -> None:
    for entry in slots:
        if entry != 0:
            kept[(entry & _INDEX) - 1] = True
