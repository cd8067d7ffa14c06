"""Detect raw Bayer frames of a colour camera, in which every second pixel is brighter.

Codes and phases of a pixel do not depend on its brightness. It matters only where neighbours are compared.
"""

import numpy as np

from calib.numerics import ENOUGH_PIXELS, SIGMA_PER_MEDIAN, Floats32, Image
from scanner.decoding.light.lit_pixels import LIT
from scanner.decoding.significance import BRIGHTEST, FEW, FEWEST_PIXELS, HALF

BAYER_PX = 2  # to the next pixel of the same colour


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
