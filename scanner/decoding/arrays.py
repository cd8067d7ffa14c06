"""Array types of the decoder, which works in single precision; shapes are given in docstrings."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats32 = NDArray[np.float32]
Component = NDArray[np.float32] | NDArray[np.int16] | NDArray[np.int32]
Words = NDArray[np.unsignedinteger[Any]]
Reasons = NDArray[np.uint8]
# Rows and columns of an image.
Part = tuple[slice, slice]
WHOLE: Part = slice(None), slice(None)
