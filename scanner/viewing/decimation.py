"""Fewer points than there are: an even choice of them, and how to say so."""

import numpy as np

from calib.numerics import Ints

# Points that a laptop without a graphics card rotates smoothly and receives in a second.
DEFAULT_SHOWN = 500_000

_SEED = 0


def shuffled(count: int) -> Ints:
    """Return a permutation of `count` points, (count,), whose every prefix is spread evenly over them; always the same.

    Every nth point in the order of the camera's rows would show stripes.
    """
    return np.random.default_rng(_SEED).permutation(count)


def statement(drawn: int, total: int) -> str:
    """State how many points are shown: 'showing 1 in 8 of 4.9 million points'."""
    if not 0 <= drawn <= total:
        raise ValueError(f"expected 0 to {total} points to be shown, found {drawn}")
    if drawn == total:
        return f"showing all {many(total)} points"
    if drawn == 0:
        return f"showing none of {many(total)} points"
    ratio = total / drawn
    return f"showing 1 in {round(ratio) if ratio >= 9.5 else f'{ratio:.2g}'} of {many(total)} points"


def many(count: int) -> str:
    """A number of points for reading: '13,024', or '4.9 million'."""
    return f"{count:,}" if count < 1_000_000 else f"{count / 1e6:.1f} million"
