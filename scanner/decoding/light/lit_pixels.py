"""Select sample pixels that the patterns light and do not saturate."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats32, evenly_spread, quantile
from scanner.decoding.significance import BRIGHTEST

# Pixels whose swing is less than this share of the brightest ones' are not lit: a Lambertian surface at 75° still is.
# Outside the picture, stray light and a camera's automatic tone mapping show the patterns as well.
LIT = 0.25


def lit_by(swing: Floats32) -> NDArray[np.intp]:
    """Return ascending indices of some lit pixels, from the swing (P,) of each."""
    return evenly_spread(np.flatnonzero(swing >= LIT * quantile(swing, BRIGHTEST)))


def unclipped(levels: NDArray[Any], saturation: float) -> NDArray[np.intp]:
    """Return ascending indices of some lit pixels that stay below `saturation` in all frames, levels (frames, P)."""
    swing = np.ptp(levels, axis=0).astype(np.float32)
    lit = lit_by(swing)
    usable: Bools = (swing[lit] > 0) & (levels[:, lit].max(axis=0) < saturation)
    return lit[usable]
