"""Array types of the decoder, which works in single precision; shapes are given in docstrings."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats32 = NDArray[np.float32]
Words = NDArray[np.unsignedinteger[Any]]
Reasons = NDArray[np.uint8]
# Smaller than all grey levels, amplitudes and powers of light that matter: it keeps a division by them finite.
NEGLIGIBLE = 1e-6
# Rows and columns of an image, and those of any of its pixels, in arrays of one shape.
Window = tuple[slice, slice]
Part = Window | tuple[NDArray[np.int64], NDArray[np.int64]]
WHOLE: Window = slice(None), slice(None)
