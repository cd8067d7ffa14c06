"""Which plane of the room a match is on, as other pairs tell it.

A projector's pixel lights one point, whichever camera sees it, and a camera's pixel sees one point, whichever projector
lights it. So labels are drawn into the image of the device that pairs share, and read there.
"""

from collections.abc import Iterable

import numpy as np

from calib.geometry import NO_FACE
from calib.networks.raster import Raster
from calib.numerics import Floats, Ints

_SURROUNDED = 4  # of eight neighbours with the same label; where a plane ends beside a cell nothing is told


def label_map(raster: Raster, labelled: Iterable[tuple[Floats, Ints]]) -> Ints:
    """Labels (h, w) of a raster's cells from pixels (N, 2) and their labels (N,) of several pairs.

    NO_FACE where none is near, where labels differ in a cell or beside it, and at the rim of what is labelled.
    """
    shape = (raster.height, raster.width)
    low, high = np.full(shape[0] * shape[1], np.iinfo(np.int32).max, np.int32), np.full(shape[0] * shape[1], NO_FACE)
    for pixels, labels in labelled:
        known = labels != NO_FACE
        flat, inside = raster.numbers(pixels[known])
        own = labels[known][inside]
        np.minimum.at(low, flat, own)
        np.maximum.at(high, flat, own)
    label = high.reshape(shape)
    padded = np.pad(np.where(high > low, -2, high).reshape(shape), 1, constant_values=NO_FACE)
    around = [
        padded[1 + y : 1 + y + shape[0], 1 + x : 1 + x + shape[1]]
        for y in (-1, 0, 1)
        for x in (-1, 0, 1)
        if (x, y) != (0, 0)
    ]
    same, none = (sum((neighbour == value).astype(np.int8) for neighbour in around) for value in (label, NO_FACE))
    certain = (padded[1:-1, 1:-1] >= 0) & (same >= _SURROUNDED) & (same + none == len(around))
    return np.where(certain, label, NO_FACE).astype(np.int32)


def read(raster: Raster, certain: Ints, pixels: Floats) -> Ints:
    """Labels (N,) of pixels (N, 2) from those of cells (h, w)."""
    flat, inside = raster.numbers(pixels)
    labels = np.full(len(pixels), NO_FACE, np.int32)
    labels[inside] = certain.ravel()[flat]
    return labels
