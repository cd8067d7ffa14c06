"""Array types for signatures, whose docstrings give the shapes; and images and pixels in the form that loops take."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.signedinteger[Any]]
Words = NDArray[np.unsignedinteger[Any]]  # whose bits are those of a code
Bools = NDArray[np.bool_]
Image = NDArray[np.uint8] | NDArray[np.uint16]
# Rows and columns of an image; or those of any of its pixels, in two arrays of one shape.
Window = tuple[slice, slice]
Part = Window | tuple[NDArray[np.int64], NDArray[np.int64]]
WHOLE: Window = slice(None), slice(None)
_FAR = 100.0  # extents from the origin, at which single precision is 6e-6 of the extent


def grey(image: NDArray[Any]) -> Floats:
    """Convert a grey (H, W) or colour image (H, W, 3) to (H, W): the mean of the channels, in grey levels."""
    values = np.asarray(image, np.float64)
    return values.mean(axis=2) if values.ndim == 3 else values


def by_columns(pixels: Floats) -> Floats:
    """Convert (N, 2) to double precision with contiguous columns."""
    return np.asfortranarray(pixels, dtype=np.float64)


def is_far(points: Floats) -> bool:
    """Whether single precision would show in points (N, 3): they are much farther from the origin than apart."""
    return len(points) > 0 and bool(np.abs(points).max() > _FAR * np.ptp(points, axis=0).max())
