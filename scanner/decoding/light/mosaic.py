"""Raw frames of a colour camera, whose pixels lie behind a mosaic of filters: every second one is brighter.

Codes and phases of a pixel do not depend on how bright it is. Only where neighbours are compared must it be known.
"""

import numpy as np

from calib.numerics import SIGMA_PER_MEDIAN, Image
from scanner.decoding.arrays import Floats32
from scanner.decoding.significance import BRIGHTEST

_PERIOD = 2
# Blocks that are lit: of the brightest few.
_LIT = 0.25
_FEWEST_BLOCKS, _MOST_BLOCKS = 200, 4000
# Logarithms by which pixels of a block differ in the median, and how much less blocks differ from each other in that.
_LEAST, _ALIKE = 0.1, 0.5


def log_mosaic(lit: Image) -> Floats32 | None:
    """The logarithm (H, W) of how bright pixels are behind their filters, from the scene fully lit; None without."""
    down, across = (size // _PERIOD for size in lit.shape)
    parts = lit[: down * _PERIOD, : across * _PERIOD].reshape(down, _PERIOD, across, _PERIOD)
    blocks = parts[:: max(1, down * across // _MOST_BLOCKS)].swapaxes(1, 2).reshape(-1, _PERIOD**2)
    mean = blocks.mean(axis=1)
    blocks = blocks[mean > _LIT * np.quantile(mean, BRIGHTEST)]
    if len(blocks) < _FEWEST_BLOCKS:
        return None
    logs = np.log(np.maximum(blocks, 1).astype(np.float32))
    logs -= logs.mean(axis=1, keepdims=True)
    of_filters = np.median(logs, axis=0)
    spread = SIGMA_PER_MEDIAN * np.median(np.abs(logs - of_filters), axis=0)
    differ = float(np.ptp(of_filters))
    if differ < _LEAST or float(spread.max()) > _ALIKE * differ:
        return None
    repeats = (-(-size // _PERIOD) for size in lit.shape)
    whole = np.tile(of_filters.reshape(_PERIOD, _PERIOD), tuple(repeats))
    return whole[: lit.shape[0], : lit.shape[1]].astype(np.float32)
