"""Single-channel images from camera images."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics.array_types import Floats


def grey(image: NDArray[Any]) -> Floats:
    """Convert a grey (H, W) or colour image (H, W, 3) to (H, W): the mean of the channels, in grey levels."""
    values = np.asarray(image, np.float64)
    return values.mean(axis=2) if values.ndim == 3 else values
