"""One capture of a corner, with its points in the corner's frame and in the camera's."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Corner, Intrinsics
from calib.numerics import Bools, Floats, Ints


@dataclass(frozen=True)
class CornerView:
    """One capture of a corner.

    `points` (H, W, 3) in the camera's frame on its pixel grid, NaN where there is none; `brightness` (H, W), or None;
    `corner` in the same frame and unit.
    """

    points: NDArray[np.float32]
    brightness: NDArray[np.float32] | None
    camera: Intrinsics
    corner: Corner

    @cached_property
    def axes(self) -> Floats:
        """The corner's axes, (3, 3) rows in the camera's frame; as of `Corner.axes`."""
        return self.corner.axes

    @cached_property
    def there(self) -> Bools:
        """Which pixels have a point, (H, W)."""
        return np.isfinite(self.points[..., 2])

    @cached_property
    def distance(self) -> float:
        """Median distance of the points from the camera."""
        return float(np.median(np.linalg.norm(self.points[self.there], axis=1))) if self.there.any() else 0.0

    def in_corner(self, points: Floats, turn: int = 0) -> Floats:
        """Points (N, 3) of the camera's frame in the corner's; `turn` renumbers its axes cyclically."""
        return np.roll((points - self.corner.vertex) @ self.axes.T, turn, axis=1)

    def in_camera(self, points: Floats, turn: int = 0) -> Floats:
        """The inverse of `in_corner`."""
        return np.roll(points, -turn, axis=1) @ self.axes + self.corner.vertex

    def depths_around(self, points: Floats) -> tuple[Floats, Floats, Bools]:
        """Smallest and largest depth (N,) in the 3 × 3 pixels around the images of points (N, 3) in the camera's
        frame, and whether there is any (N,).
        """
        pixels = self.camera.project(points)
        with np.errstate(invalid="ignore"):
            sees = (points[:, 2] > 0) & np.all(
                (pixels >= 0) & (pixels <= np.array(self.there.shape[::-1]) - 1.0), axis=1
            )
        column, row = np.rint(pixels[sees]).astype(np.int64).T
        height, width = self.there.shape
        around = np.stack(
            [
                self.points[np.clip(row + dy, 0, height - 1), np.clip(column + dx, 0, width - 1), 2]
                for dy, dx in product((-1, 0, 1), repeat=2)
            ]
        )
        nearest, farthest = np.full(len(points), np.nan), np.full(len(points), np.nan)
        nearest[sees] = np.fmin.reduce(around)
        farthest[sees] = np.fmax.reduce(around)
        return nearest, farthest, np.isfinite(nearest)


def cells_of(points: Floats, size: float) -> Ints:
    """The index (N,) of the voxel, with edges of `size`, that contains each point (N, 3)."""
    cell = np.floor(points / size).astype(np.int64) if len(points) else np.zeros((0, 3), np.int64)
    cell -= cell.min(axis=0, initial=0)
    extent = cell.max(axis=0, initial=0) + 1
    numbers: Ints = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
    return numbers
