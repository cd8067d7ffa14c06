"""Subsample the lines of an image, for checks that need no more."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def lines_of(image: NDArray[Any], count: int) -> NDArray[Any]:
    """Return at most `count` rows, evenly spread over an image (H, W), contiguous in memory."""
    chosen = np.unique(np.linspace(0, len(image) - 1, count).astype(np.int64))
    return np.ascontiguousarray(image[chosen])
