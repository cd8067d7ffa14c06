"""Derivatives by pixels from differences."""

from collections.abc import Callable

import numpy as np

from calib.numerics.array_types import Floats

_STEP_PX = 0.5


def by_pixel(values: Callable[[Floats], Floats], pixels: Floats) -> Floats:
    """Of smooth `values` (N, ...) of pixels (N, 2), (N, ..., 2): central differences over one pixel."""
    ways = _STEP_PX * np.eye(2)
    return np.stack([(values(pixels + way) - values(pixels - way)) / (2 * _STEP_PX) for way in ways], axis=-1)
