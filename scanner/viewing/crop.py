"""A box in a cloud: its points, its edges, and a file of its points."""

from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from calib.numerics import Bools, Floats
from scanner.io import write_merged_ply, write_ply, write_room_ply
from scanner.quantities import FACE_NAMES
from scanner.viewing.result import CaptureCloud, ViewedCloud

# Outliers do not extend a range: at its ends a box is open.
_STRAYS = 0.001
_EDGES = [(a, b) for a in range(8) for b in range(8) if a < b and (a ^ b).bit_count() == 1]


@dataclass(frozen=True)
class BoxFrame:
    """Axes that a box is along: rows of `axes` (3, 3) from `origin` (3,), in the cloud's frame; `names` of them.

    `low` and `high` (3,): the range of the cloud's points along each.
    """

    axes: Floats
    origin: Floats
    names: tuple[str, ...]
    low: Floats
    high: Floats

    def along(self, points: Floats) -> Floats:
        """Coordinates (N, 3) of points along the axes."""
        return (points - self.origin) @ self.axes.T


@dataclass(frozen=True)
class Box:
    """Between `low` and `high` (3,) along the axes of a frame; infinite where it has no wall."""

    frame: BoxFrame
    low: Floats
    high: Floats

    def holds(self, points: Floats) -> Bools:
        """Which points (N, 3) are in it, (N,)."""
        along = self.frame.along(points)
        inside: Bools = np.all((along >= self.low) & (along <= self.high), axis=1)
        return inside

    @property
    def bounded(self) -> bool:
        """Whether it has a wall."""
        return bool(np.isfinite(self.low).any() or np.isfinite(self.high).any())

    @property
    def edges(self) -> Floats:
        """Its edges (12, 2, 3) in the cloud's frame; where it has no wall, they end with the cloud."""
        ends = np.stack([np.maximum(self.low, self.frame.low), np.minimum(self.high, self.frame.high)])
        corners = np.array(
            [[ends[end, axis] for axis, end in enumerate(chosen)] for chosen in product((0, 1), repeat=3)]
        )
        lines: Floats = (corners @ self.frame.axes + self.frame.origin)[np.array(_EDGES)]
        return lines


def frame_of(cloud: ViewedCloud) -> BoxFrame:
    """Along the edges of the corner, as distances from its faces, where one capture shows it; else the cloud's own."""
    axes, origin = np.eye(3), np.zeros(3)
    names: tuple[str, ...] = ("x", "y", "z")
    if isinstance(cloud, CaptureCloud) and cloud.corner is not None:
        corner = cloud.corner.corner
        # Its axes are right-handed: for legs numbered clockwise, two have been exchanged.
        order = [0, 1, 2] if np.linalg.det(corner.legs) > 0 else [0, 2, 1]
        axes, origin = corner.axes[order], corner.vertex
        names = tuple(f"From face {name}" for name in FACE_NAMES)
    along = (cloud.points - origin) @ axes.T
    low, high = np.quantile(along, (_STRAYS, 1 - _STRAYS), axis=0)
    return BoxFrame(axes, origin, names, low, high)


def whole(cloud: ViewedCloud) -> Box:
    """A box without walls."""
    return Box(frame_of(cloud), np.full(3, -np.inf), np.full(3, np.inf))


def box_within(frame: BoxFrame, ranges: Floats) -> Box:
    """A box with `ranges` (3, 2) along the axes; at an end of the cloud it has no wall."""
    low = np.where(ranges[:, 0] <= frame.low, -np.inf, ranges[:, 0])
    high = np.where(ranges[:, 1] >= frame.high, np.inf, ranges[:, 1])
    return Box(frame, low, high)


def write_cropped(path: Path, cloud: ViewedCloud, box: Box) -> int:
    """Write the points in the box as PLY, in the frame of the cloud; returns how many. Raises OSError."""
    inside = np.flatnonzero(box.holds(cloud.points))
    part = replace(cloud, points=cloud.points[inside], normals=cloud.normals[inside], colours=cloud.colours[inside])
    write = {"camera": write_ply, "corner": write_merged_ply, "room": write_room_ply}[cloud.frame]
    write(path, part)
    return len(inside)
