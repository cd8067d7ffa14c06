"""The edges of a Gray code's stripes between camera pixels, kept as its frames arrive.

An edge is where pattern and inverse are equally bright (Trobina, Error model of a coded-light range sensor, ETH Zürich,
1995). Blur that is alike on both sides leaves it where it is, and so does any response curve of the camera. Between two
camera pixels the difference of the two is taken to be straight; it is divided by their sum, so that a surface that is
darker at one pixel than at the next moves no edge. Each edge of a Gray code belongs to one bit, and to one place of the
projector, which the code words on either side of it tell.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image, compiled
from scanner.decoding.arrays import Floats32

Packed = NDArray[np.uint16]

# Packed: the place in the lower bits, and the bit's number in the upper ones, so that of two the coarser is the larger.
PLACE_BITS = 11
COARSEST = 31


class StripeEdges:
    """Between each pixel (H, W) and its right neighbour, and the one below: one edge at most, of the coarsest bit.

    `packed`: for either direction (H, W); 0 where there is none, else `COARSEST` − bit times 2^`PLACE_BITS`, plus the
    distance from the pixel in parts of 2^`PLACE_BITS` − 1. `contrast`: mean |bright − dark| of the two pixels, in grey
    levels, as of `GrayFold`.
    """

    def __init__(self, shape: tuple[int, int], dtype: np.dtype[Any]) -> None:
        self.packed = np.zeros((2, *shape), np.uint16)
        self.contrast: Image = np.zeros((2, *shape), dtype)

    def fold(self, bit: int, bright: Image, dark: Image, threshold: Image | None = None) -> None:
        """Note the edges of a bit, (H, W); `threshold`: which of the two is half-way between lit and unlit."""
        if bit >= COARSEST:
            return
        number, largest = np.uint16(COARSEST - bit << PLACE_BITS), np.float32(np.iinfo(bright.dtype).max)
        # A threshold has twice the sum of light and no light at all, and half the difference.
        sums = (bright, dark) if threshold is None else (threshold, threshold)
        by = np.float32(0.5 if threshold is None else 1.0)
        for packed, contrast, down, across in zip(self.packed, self.contrast, (0, 1), (1, 0), strict=True):
            _note_edges(bright, dark, *sums, number, by, largest, packed, contrast, down, across)


def unpacked(packed: Packed) -> tuple[NDArray[np.int32], Floats32]:
    """The numbers of bits, `COARSEST` where there is no edge, and the distances from the pixel, 0 to 1; any shape."""
    bit = COARSEST - (packed >> PLACE_BITS).astype(np.int32)
    last = (1 << PLACE_BITS) - 1
    return bit, (packed & np.uint16(last)).astype(np.float32) / np.float32(last)


@compiled
def _note_edges(
    bright: Image,
    dark: Image,
    one: Image,
    other: Image,
    number: np.uint16,
    by: np.float32,
    largest: np.float32,
    packed: Packed,
    contrast: Image,
    down: int,
    across: int,
) -> None:
    """Where the sign of bright − dark changes towards the pixel so far down and across; light is `one` + `other`."""
    height, width = bright.shape
    last = np.float32((1 << PLACE_BITS) - 1)
    for row in range(height - down):
        bright_here, dark_here = bright[row, : width - across], dark[row, : width - across]
        bright_there, dark_there = bright[row + down, across:], dark[row + down, across:]
        for i in range(width - across):
            if (bright_here[i] > dark_here[i]) == (bright_there[i] > dark_there[i]) or packed[row, i] > number:
                continue
            here = abs(np.float32(bright_here[i]) - np.float32(dark_here[i]))
            there = abs(np.float32(bright_there[i]) - np.float32(dark_there[i]))
            light_here = np.float32(one[row, i]) + np.float32(other[row, i])
            light_there = np.float32(one[row + down, i + across]) + np.float32(other[row + down, i + across])
            near, far = here * light_there, there * light_here
            place = near / max(near + far, np.float32(1e-6))
            packed[row, i] = number + np.uint16(place * last + np.float32(0.5))
            contrast[row, i] = min(by * (here + there) + np.float32(0.5), largest)
