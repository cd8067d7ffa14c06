"""Some lines of an image, for checks that need no more."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def lines_of(image: NDArray[Any], count: int) -> NDArray[Any]:
    """So many rows, evenly spread over an image (H, W) that has more, each in one piece of memory."""
    chosen = np.unique(np.linspace(0, len(image) - 1, count).astype(np.int64))
    return np.ascontiguousarray(image[chosen])
