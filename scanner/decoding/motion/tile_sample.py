"""Small tiles of every frame: what motion between frames is measured from."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats, Image, Ints
from scanner.decoding.arrays import Floats32

TILE_PX = 10
# So many tiles along each side of the image, as far as they fit.
_MOST_ALONG = 24


@dataclass
class TileSample:
    """Square tiles on a regular grid over images of `shape` (H, W), from those frames that are of fringes.

    Frames are numbered as they arrive.
    """

    shape: tuple[int, int]
    _frames: dict[int, Image] = field(default_factory=dict)
    _moved: Bools | None = None

    def leave_out(self, moved: Bools) -> None:
        """Tell nothing of devices from pixels of the image (H, W) where something else moved."""
        self._moved = cast(Bools, self.of(moved))

    @property
    def resting(self) -> Bools:
        """(P,): the pixels that tell of devices."""
        return np.ones(len(self.tile), np.bool_) if self._moved is None else ~self._moved

    def add(self, number: int, grey: Image) -> None:
        """Take the tiles of a frame (H, W)."""
        self._frames[number] = cast(Image, self.of(grey))

    def of(self, image: NDArray[np.generic]) -> NDArray[np.generic]:
        """The tiles of an image (H, W), one after the other, (P,)."""
        (top, down, rows), (left, right, columns) = (_grid(size) for size in self.shape)
        part = image[top : top + rows * down, left : left + columns * right].reshape(rows, down, columns, right)
        tiles = part[:, :TILE_PX, :, :TILE_PX].swapaxes(1, 2)
        return np.ascontiguousarray(tiles).reshape(-1)

    @property
    def count(self) -> int:
        """How many tiles there are; none in an image that is smaller than one."""
        return _grid(self.shape[0])[2] * _grid(self.shape[1])[2]

    @cached_property
    def camera_px(self) -> Floats:
        """(P, 2): where the pixels of the tiles are."""
        (top, down, rows), (left, right, columns) = (_grid(size) for size in self.shape)
        y = top + np.arange(rows)[:, None, None, None] * down + np.arange(TILE_PX)[:, None]
        x = left + np.arange(columns)[:, None, None] * right + np.arange(TILE_PX)
        return np.stack([part.reshape(-1) for part in np.broadcast_arrays(x, y)], axis=1).astype(np.float64)

    @cached_property
    def tile(self) -> Ints:
        """(P,): the number of the tile that each pixel belongs to."""
        return np.repeat(np.arange(self.count), TILE_PX**2)

    @property
    def rows(self) -> Ints:
        """(P,): the rows of the image that they are in."""
        return self.camera_px[:, 1].astype(np.int64)

    def divide(self, frame: int, by: Floats) -> None:
        """Make a frame darker by so many times, (P,), if it is one of a fringe."""
        if frame in self._frames:
            self._frames[frame] = cast(Image, (self._frames[frame] / by).astype(np.float32))

    def levels(self, frames: list[int], pixels: Ints) -> Floats32:
        """(frames, pixels): grey levels."""
        return np.stack([self._frames[frame][pixels] for frame in frames]).astype(np.float32)


def _grid(size: int) -> tuple[int, int, int]:
    """Where the first tile begins along a side, from one to the next, and how many there are."""
    count = min(_MOST_ALONG, size // TILE_PX)
    if not count:
        return 0, 1, 0
    step = size // count
    return (size - count * step) // 2, step, count
