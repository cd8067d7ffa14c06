"""The grey level from which on a camera's pixel is clipped."""

from math import inf

import numpy as np

from calib.numerics import Image

# What cameras of 10, 12, 14 and 16 bits write into 16: at the low end, or shifted to the high end.
_FULL_SCALES = tuple(((1 << bits) - 1) << shift for bits in (10, 12, 14, 16) for shift in {0, 16 - bits})
# JPEG spreads clipped pixels over the last two levels.
_CLIPPED_8_BIT = 254.0


def saturation_level(peak: Image) -> float:
    """The lowest clipped level of a capture whose largest grey levels are `peak`; infinity if nothing is clipped.

    How many bits a 16-bit image uses is not recorded, but a clipped one reaches the largest number of its bits exactly.
    """
    if peak.dtype == np.uint8:
        return _CLIPPED_8_BIT
    top = int(peak.max())
    return float(top) if top in _FULL_SCALES else inf
