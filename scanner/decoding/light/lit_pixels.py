"""Pixels of a sample that the patterns light up, and do not saturate."""

import numpy as np
from numpy.typing import NDArray

from scanner.decoding.arrays import Floats32
from scanner.decoding.significance import BRIGHTEST

# Pixels that swing less than this share of what the brightest few do are hardly lit.
_LIT = 0.25
_MOST_PIXELS = 4096  # enough for a few numbers


def lit_by(swing: Floats32) -> NDArray[np.intp]:
    """Some of the pixels that the patterns light up, from how much they change (P,): places in it, which rise."""
    lit = np.flatnonzero(swing >= _LIT * np.quantile(swing, BRIGHTEST))
    return lit[:: -(-len(lit) // _MOST_PIXELS)]


def unclipped(levels: Floats32, saturation: float) -> Floats32:
    """The levels (frames, P) of some of the pixels that are lit, and below `saturation` in all frames."""
    swing = np.ptp(levels, axis=0)
    lit = lit_by(swing)
    return levels[:, lit[(swing[lit] > 0) & (levels[:, lit].max(axis=0) < saturation)]]


def thinned(levels: Floats32, most: int) -> Floats32:
    """Every so many pixels of `levels` (…, P), so that `most` are left."""
    return levels[..., :: -(-levels.shape[-1] // most)]
