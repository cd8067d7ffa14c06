"""Sums over small square tiles that cover an image, of products of its pictures."""

from collections.abc import Sequence

import numpy as np

from calib.numerics import Bools, Floats
from scanner.decoding.arrays import Floats32

TILE_PX = 16


def moments_of_tiles(pictures: Sequence[Floats32], chosen: Bools) -> Floats:
    """Sums (rows, columns, N, N) of the products of each two of N pictures (H, W) over the `chosen` pixels (H, W)."""
    rows, columns = (size // TILE_PX for size in chosen.shape)
    moments = np.empty((rows, columns, len(pictures), len(pictures)))
    for row in range(rows):
        part = slice(row * TILE_PX, (row + 1) * TILE_PX), slice(0, columns * TILE_PX)
        stacked = np.stack([np.where(chosen[part], picture[part], 0) for picture in pictures]).astype(np.float64)
        tiles = stacked.reshape(len(pictures), TILE_PX, columns, TILE_PX).transpose(2, 0, 1, 3)
        flat = tiles.reshape(columns, len(pictures), -1)
        moments[row] = flat @ flat.transpose(0, 2, 1)
    return moments


def centres_of_tiles(shape: tuple[int, ...]) -> Floats:
    """The middles (rows, columns, 2), x and y, of the tiles of an image of `shape` (H, W)."""
    rows, columns = (np.arange(size // TILE_PX, dtype=np.float64) for size in shape)
    centres: Floats = np.stack(np.meshgrid(columns, rows), axis=-1) * TILE_PX + (TILE_PX - 1) / 2
    return centres
