"""The grey level from which a camera pixel is clipped."""

from math import inf

import numpy as np

from calib.numerics import Image

# Full scales of 10, 12, 14 and 16 bits in a 16-bit image, aligned low or high.
_FULL_SCALES = tuple(((1 << bits) - 1) << shift for bits in (10, 12, 14, 16) for shift in {0, 16 - bits})
# JPEG spreads clipped pixels over the last two levels.
_CLIPPED_8_BIT = 254.0


def saturation_level(*images: Image) -> float:
    """Return the lowest clipped level of images that have the largest grey levels of a capture; infinity if nothing is
    clipped.

    The bit depth within a 16-bit image is not recorded, but clipped pixels have exactly the largest number of its bits.
    """
    if images[0].dtype == np.uint8:
        return _CLIPPED_8_BIT
    top = max(int(image.max()) for image in images)
    return float(top) if top in _FULL_SCALES else inf
