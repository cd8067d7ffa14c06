"""Images of one channel, of what cameras deliver."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics.array_types import Floats


def grey(image: NDArray[Any]) -> Floats:
    """(H, W) of a grey image (H, W) or one in colour (H, W, 3), in its grey levels: the mean of the channels."""
    values = np.asarray(image, np.float64)
    return values.mean(axis=2) if values.ndim == 3 else values
