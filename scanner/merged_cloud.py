"""Clouds of several captures in one frame, that of the corner which all of them see."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Bools, Floats
from calib.corner_view import View, cells_of
from scanner.cloud import Cloud


@dataclass(frozen=True)
class MergedCloud:
    """Points in the corner's frame: origin at the vertex, axes along the legs, z along the most upright one.

    `points` (N, 3) in `unit`, `colours` (N, 3) RGB, `normals` (N, 3) facing the camera that saw the point. `grid`: at
    most one point in each cube with this edge. `turns`: for each capture, as of `View.in_corner`; `from_cameras`: for
    each the pose (3, 4) that takes points of its camera's frame there.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8]
    normals: NDArray[np.float32]
    unit: str
    grid: float
    turns: tuple[int, ...]
    from_cameras: tuple[Floats, ...]

    @property
    def there(self) -> Bools:
        """Which points are there, (N,): all."""
        return np.ones(len(self.points), dtype=np.bool_)


def merged(clouds: Sequence[Cloud], views: Sequence[View], turns: tuple[int, ...]) -> MergedCloud:
    """All clouds in the corner's frame; of points in one cube of the grid the one that is nearest to its camera.

    The grid's edge is the distance between neighbouring camera pixels at the captures' median distance.
    """
    points, normals, colours, far = [], [], [], []
    for cloud, view, turn in zip(clouds, views, turns, strict=True):
        seen = cloud.points[cloud.there].astype(np.float64)
        points.append(view.in_corner(seen, turn))
        normals.append(np.roll(cloud.normals[cloud.there].astype(np.float64) @ view.axes.T, turn, axis=1))
        colours.append(cloud.colours[cloud.there])
        far.append(np.linalg.norm(seen, axis=1))
    grid = float(np.median([view.distance / np.mean(view.camera.focal_px) for view in views]))
    everything, distance = np.concatenate(points), np.concatenate(far)
    order = np.argsort(distance, kind="stable")
    kept = np.sort(order[np.unique(cells_of(everything, grid)[order], return_index=True)[1]])
    return MergedCloud(
        everything[kept].astype(np.float32),
        np.concatenate(colours)[kept],
        np.concatenate(normals)[kept].astype(np.float32),
        clouds[0].unit,
        grid,
        turns,
        tuple(_pose(view, turn) for view, turn in zip(views, turns, strict=True)),
    )


def _pose(view: View, turn: int) -> Floats:
    """The pose (3, 4) of a view's camera in the corner's frame."""
    moved = view.in_corner(np.vstack([np.zeros(3), np.eye(3)]), turn)
    return np.column_stack([(moved[1:] - moved[0]).T, moved[0]])
