"""Locate the stripe edges of a Gray code between camera pixels.

An edge is where pattern and inverse are equally bright (Trobina, Error model of a coded-light range sensor, ETH Zürich,
1995). Symmetric blur and the camera's response curve leave it in place. The difference of the two is interpolated
linearly between two camera pixels; it is divided by their sum, so that a change of albedo between the pixels does not
move the edge. Each edge of a Gray code belongs to one bit, and to one projector coordinate, which the code words on
either side determine.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Image, compiled
from scanner.decoding.arrays import Floats32
from scanner.decoding.sequence_plan import GrayCode

Packed = NDArray[np.uint16]

# Packed: position in the lower bits, number in the upper ones, so that the larger of two values is the coarser bit.
PLACE_BITS = 11
COARSEST = 31


class StripeEdges:
    """Edges between each pixel (H, W) and its right and lower neighbours; at most one each, that of the coarsest bit.

    `packed`: per direction (H, W); 0 without an edge, else (`COARSEST` − bit) · 2^`PLACE_BITS` plus the distance from
    the pixel in units of 1 / (2^`PLACE_BITS` − 1). `contrast`: mean |bright − dark| of the two pixels, in grey levels,
    as in `GrayFold`.
    """

    def __init__(self, shape: tuple[int, int], dtype: np.dtype[Any]) -> None:
        self.packed = np.zeros((2, *shape), np.uint16)
        self.contrast: Image = np.zeros((2, *shape), dtype)

    def fold(self, bit: int, bright: Image, dark: Image, threshold: Image | None = None) -> None:
        """Add the edges of a bit, (H, W); `threshold`: the one of the two images that is half-way between lit and
        unlit.
        """
        if bit >= COARSEST:
            return
        number, largest = np.uint16(COARSEST - bit << PLACE_BITS), np.float32(np.iinfo(bright.dtype).max)
        # Of a frame and its threshold: twice the threshold replaces the sum, and the difference is half.
        sums = (bright, dark) if threshold is None else (threshold, threshold)
        by = np.float32(0.5 if threshold is None else 1.0)
        for packed, contrast, down, across in zip(self.packed, self.contrast, (0, 1), (1, 0), strict=True):
            _note_edges(bright, dark, *sums, number, by, largest, packed, contrast, down, across)


def edges_of(
    code: GrayCode, frames: Iterable[tuple[int, Image]], thresholds: Mapping[int, Image], like: Image
) -> StripeEdges:
    """Find the edges in the frames (H, W) of a capture, by index, of which the code's count; `thresholds` (H, W): as in
    `Accumulators`. `like` (H, W): an image of the same shape and type.
    """
    found = StripeEdges((like.shape[0], like.shape[1]), like.dtype)
    of_pairs = {frame: (bit, pair) for bit, pair in code.pairs.items() for frame in pair}
    alone = {frame: bit for bit, frame in code.unpaired.items()}
    waiting: dict[int, Image] = {}
    for index, image in frames:
        if index in alone:
            images = {True: image, False: thresholds[index]}
            is_inverse = alone[index] in code.inverse
            found.fold(alone[index], images[not is_inverse], images[is_inverse], thresholds[index])
        elif index in of_pairs:
            waiting[index] = image
            bit, (normal, inverse) = of_pairs[index]
            if normal in waiting and inverse in waiting:
                found.fold(bit, waiting.pop(normal), waiting.pop(inverse))
    return found


def unpacked(packed: Packed) -> tuple[NDArray[np.int32], Floats32]:
    """Return the bit numbers, `COARSEST` where there is no edge, and the distances from the pixel,
    0 to 1; any shape.
    """
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
    """Record where bright − dark changes sign towards the pixel `down` and `across`, normalised by `one` + `other`."""
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
