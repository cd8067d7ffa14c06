"""Subsamples of images and of lists of pixels, for estimates and checks that need no more."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Ints

# Pixels of a sample: their median has a standard error of 1.25 / √n, a fiftieth of their standard deviation.
ENOUGH_PIXELS = 4096
# The same where hundreds of trials are made: a sixteenth of it.
TRIAL_PIXELS = 400
# Pixels for an effect smaller than their scatter that the whole picture shows: a two hundredth of it.
MANY_PIXELS = 65536
# Lines of an image, along which neighbours are compared: they cross thousands of edges between a code's cells.
_LINES = 128
# Neighbours on a line may have this many px between them that are unlit or uncertain.
FARTHEST_PX = 16
SEED = 20_240_229  # of all random choices, which must be the same in every run


def evenly_spread(values: NDArray[Any], most: int = ENOUGH_PIXELS, axis: int = 0) -> NDArray[Any]:
    """Return every k-th of the values (N, …), or (…, N) along the last `axis`, as many as possible up to `most`."""
    step = max(1, -(-values.shape[axis] // most))
    return values[::step] if axis == 0 else np.ascontiguousarray(values[..., ::step])


def at_random(count: int, most: int = ENOUGH_PIXELS) -> Ints:
    """Return at most so many of the numbers below `count`, in ascending order; they cannot beat with a pattern."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(SEED).choice(count, most, replace=False))


def lines_of(image: NDArray[Any]) -> NDArray[Any]:
    """Return some rows, evenly spread over an image (H, W), contiguous in memory."""
    return np.ascontiguousarray(evenly_spread(image, _LINES))
