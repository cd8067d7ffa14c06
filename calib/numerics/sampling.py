"""Samples that are spread evenly over what they are taken from."""

import numpy as np

from calib.numerics.array_types import Bools, Ints


def evenly(chosen: Bools, size: int) -> Ints:
    """Indices of elements of a mask (N,) that are set, evenly spaced among them: all, or `size` to twice as many."""
    indices = np.flatnonzero(chosen)
    return indices[:: max(1, len(indices) // size)]
