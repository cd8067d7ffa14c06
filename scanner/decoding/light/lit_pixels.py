"""What the levels of pixels tell before decoding: which are lit, which are clipped, which are behind a colour filter.

Codes and phases of a pixel do not depend on its brightness. The mosaic of a raw colour image, in which every second
pixel is brighter, matters only where neighbours are compared.
"""

from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import ENOUGH_PIXELS, SIGMA_PER_MEDIAN, Bools, Floats32, Image, evenly_spread, quantile
from scanner.decoding.significance import BRIGHTEST, FEW, FEWEST_PIXELS, HALF

# Pixels whose swing is less than this share of the brightest ones' are not lit: a Lambertian surface at 75° still is.
# Outside the picture, stray light and a camera's automatic tone mapping show the patterns as well.
LIT = 0.25
# Full scales of 10, 12, 14 and 16 bits in a 16-bit image, aligned low or high.
_FULL_SCALES = tuple(((1 << bits) - 1) << shift for bits in (10, 12, 14, 16) for shift in {0, 16 - bits})
# JPEG spreads clipped pixels over the last two levels.
_CLIPPED_8_BIT = 254.0
BAYER_PX = 2  # to the next pixel of the same colour


def lit_by(swing: Floats32) -> NDArray[np.intp]:
    """Return ascending indices of some lit pixels, from the swing (P,) of each."""
    return evenly_spread(np.flatnonzero(swing >= LIT * quantile(swing, BRIGHTEST)))


def unclipped(levels: NDArray[Any], saturation: float) -> NDArray[np.intp]:
    """Return ascending indices of some lit pixels that stay below `saturation` in all frames, levels (frames, P)."""
    swing = np.ptp(levels, axis=0).astype(np.float32)
    lit = lit_by(swing)
    usable: Bools = (swing[lit] > 0) & (levels[:, lit].max(axis=0) < saturation)
    return lit[usable]


def saturation_level(*images: Image) -> float:
    """Return the lowest clipped level of images that have the largest grey levels of a capture; infinity if nothing is
    clipped.

    The bit depth within a 16-bit image is not recorded, but clipped pixels have exactly the largest number of its bits.
    """
    if images[0].dtype == np.uint8:
        return _CLIPPED_8_BIT
    top = max(int(image.max()) for image in images)
    return float(top) if top in _FULL_SCALES else inf


def log_mosaic(lit: Image) -> Floats32 | None:
    """Return the log brightness (H, W) of each pixel's filter, from the fully lit scene; None without a mosaic."""
    down, across = (size // BAYER_PX for size in lit.shape)
    parts = lit[: down * BAYER_PX, : across * BAYER_PX].reshape(down, BAYER_PX, across, BAYER_PX)
    blocks = parts[:: max(1, down * across // ENOUGH_PIXELS)].swapaxes(1, 2).reshape(-1, BAYER_PX**2)
    mean = blocks.mean(axis=1)
    blocks = blocks[mean > LIT * np.quantile(mean, BRIGHTEST)]
    if len(blocks) < FEWEST_PIXELS:
        return None
    logs = np.log(np.maximum(blocks, 1).astype(np.float32))
    logs -= logs.mean(axis=1, keepdims=True)
    of_filters = np.median(logs, axis=0)
    spread = SIGMA_PER_MEDIAN * np.median(np.abs(logs - of_filters), axis=0)
    differ = float(np.ptp(of_filters))
    if differ < FEW or float(spread.max()) > HALF * differ:
        return None
    repeats = (-(-size // BAYER_PX) for size in lit.shape)
    whole = np.tile(of_filters.reshape(BAYER_PX, BAYER_PX), tuple(repeats))
    return whole[: lit.shape[0], : lit.shape[1]].astype(np.float32)
