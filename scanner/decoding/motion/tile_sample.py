"""Small tiles of every fringe frame, from which motion between frames is measured."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Image, Ints
from scanner.decoding.arrays import Floats32

TILE_PX, MOST_ALONG = 10, 24  # size of a tile; largest number of tiles along each side of the image


@dataclass
class TileSample:
    """Square tiles on a regular grid over the fringe frames, of `shape` (H, W).

    Frames are numbered in the order of arrival.
    """

    shape: tuple[int, int]
    _frames: dict[int, Image] = field(default_factory=dict)
    _moved: Bools | None = None

    def leave_out(self, moved: Bools) -> None:
        """Exclude pixels of the image (H, W) where objects moved."""
        self._moved = cast(Bools, self.of(moved))

    @property
    def resting(self) -> Bools:
        """(P,): the pixels that were not excluded."""
        return np.ones(len(self.tile), np.bool_) if self._moved is None else ~self._moved

    def add(self, number: int, grey: Image) -> None:
        """Store the tiles of a frame (H, W)."""
        self._frames[number] = cast(Image, self.of(grey))

    def of(self, image: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return the pixels (P,) of an image (H, W) that lie in tiles, tile by tile."""
        (top, down, rows), (left, right, columns) = (_grid(size) for size in self.shape)
        part = image[top : top + rows * down, left : left + columns * right].reshape(rows, down, columns, right)
        tiles = part[:, :TILE_PX, :, :TILE_PX].swapaxes(1, 2)
        return np.ascontiguousarray(tiles).reshape(-1)

    @property
    def count(self) -> int:
        """Number of tiles; zero for an image smaller than one."""
        return _grid(self.shape[0])[2] * _grid(self.shape[1])[2]

    @cached_property
    def camera_px(self) -> Floats:
        """(P, 2): camera coordinates of the pixels."""
        (top, down, rows), (left, right, columns) = (_grid(size) for size in self.shape)
        y = top + np.arange(rows)[:, None, None, None] * down + np.arange(TILE_PX)[:, None]
        x = left + np.arange(columns)[:, None, None] * right + np.arange(TILE_PX)
        return np.stack([part.reshape(-1) for part in np.broadcast_arrays(x, y)], axis=1).astype(np.float64)

    @cached_property
    def tile(self) -> Ints:
        """(P,): the tile number of each pixel."""
        return np.repeat(np.arange(self.count), TILE_PX**2)

    @property
    def rows(self) -> Ints:
        """(P,): the image row of each pixel."""
        return self.camera_px[:, 1].astype(np.int64)

    def divide(self, frame: int, by: Floats) -> None:
        """Divide the grey levels of a frame by a factor per pixel, (P,), if it is stored."""
        if frame in self._frames:
            self._frames[frame] = cast(Image, (self._frames[frame] / by).astype(np.float32))

    def levels(self, frames: list[int], pixels: Ints) -> Floats32:
        """(frames, pixels): grey levels."""
        return np.stack([self._frames[frame][pixels] for frame in frames]).astype(np.float32)


def _grid(size: int) -> tuple[int, int, int]:
    """Return the start of the first tile along a side, their spacing, and their number."""
    count = min(MOST_ALONG, size // TILE_PX)
    if not count:
        return 0, 1, 0
    step = size // count
    return (size - count * step) // 2, step, count
