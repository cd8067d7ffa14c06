"""Flags against a camera pixel, and the mask reason that they lead to.

The loops are compiled. They have no branches and few arrays each, so that they run on many pixels at once.
"""

from collections.abc import Collection
from enum import IntEnum, IntFlag
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import Floats32, Image, Ints, compiled

# A mask reason, or flags, for each pixel.
Reasons = NDArray[np.uint8]


class MaskReason(IntEnum):
    """Why a camera pixel has no match."""

    KEPT = 0
    DARK = 1
    """The patterns change its brightness by no more than the noise."""
    SATURATED = 2
    """A fringe reached the camera's largest value."""
    UNDECIDED = 3
    """A bit of the Gray code is within the noise of its threshold, and no fringe helps."""
    INCONSISTENT = 4
    """Gray codes and fringes contradict each other, or are ambiguous."""
    OUTSIDE = 5
    """The code belongs to no projector pixel, or to none that the calibration allows for this pixel."""
    ISOLATED = 6
    """It does not continue the surface of its neighbours: an edge of surface or light, or an isolated outlier."""
    INDIRECT = 7
    """Codes and fringes contradict each other where more light comes from other surfaces than from the projector."""
    ALONG_EPIPOLAR_LINE = 8
    """Only stripes along its epipolar line were shown, which do not determine its depth."""
    MOVED = 9
    """Something moved there during the capture, so that its frames contradict each other."""


# Reasons that are frequent only if the frames are not what the capture says.
CONTRADICTIONS = (MaskReason.INCONSISTENT, MaskReason.INDIRECT, MaskReason.OUTSIDE)
BROKEN = (*CONTRADICTIONS, MaskReason.ISOLATED)


class PixelFlags(IntFlag):
    """Flags against a pixel along one axis; several may be set, and the first one determines the reason."""

    DARK = 1
    SATURATED = 2
    UNDECIDED = 4
    INDIRECT = 8
    OUTSIDE = 16
    DISAGREES = 32
    AMBIGUOUS = 64
    CONTRADICTORY = 128


# The flags without a reason of their own are contradictions.
_REASONS = {flag: getattr(MaskReason, str(flag.name), MaskReason.INCONSISTENT) for flag in PixelFlags}
_TABLE = np.array(
    [next((reason for flag, reason in _REASONS.items() if flag & flags), MaskReason.KEPT) for flags in range(256)],
    np.uint8,
)
UNCERTAIN = PixelFlags.DISAGREES | PixelFlags.AMBIGUOUS
NOT_LIT = PixelFlags.DARK | PixelFlags.SATURATED

_DARK, _SATURATED, _UNDECIDED, _INDIRECT, *_ = map(np.uint8, PixelFlags)
_NOTHING, _DOUBTFUL = map(np.uint8, (PixelFlags(0), UNCERTAIN | PixelFlags.CONTRADICTORY))
_ZERO, _TWO, _FOUR = np.float32(0), np.float32(2), np.float32(4)


def reasons_of(flags: Reasons) -> Reasons:
    """Return the `MaskReason` of each pixel, from its flags (P,)."""
    return cast(Reasons, cv2.LUT(flags, _TABLE).reshape(flags.shape))


def count_reasons(reasons: Reasons, of_interest: Collection[MaskReason]) -> Ints:
    """Return how many pixels, in an array of any shape, have each `MaskReason` of interest; 0 for the others."""
    counts = np.zeros(len(MaskReason), np.int64)
    for reason in of_interest:
        counts[reason] = np.count_nonzero(reasons == np.uint8(reason))
    return counts


@compiled
def flag_light(
    variance: Floats32,
    at_black: np.float32,
    per_level: np.float32,
    white: Floats32,
    threshold: Floats32,
    peak: Image,
    darkest: np.float32,
    saturation: np.float32,
    flags: Reasons,
) -> None:
    """Flag pixels where the longest fringe is not seen, or a fringe is clipped, and doubtful ones where direct light
    (twice the amplitude) is less than half of all light.

    The amplitude is that of fringes too short for interreflection to transport, which separate direct from global light
    (Nayar et al., SIGGRAPH 2006). Its square divides their variance: `at_black` and `per_level` are those of an
    amplitude of 1.
    """
    for i in range(len(flags)):
        half_of_all, power = white[i] - threshold[i], (at_black + per_level * threshold[i]) / variance[i]
        indirect = (half_of_all * half_of_all > _FOUR * power) & (flags[i] & _DOUBTFUL != 0)
        saturated = _SATURATED if np.float32(peak[i]) >= saturation else _NOTHING
        flags[i] |= saturated | (_DARK if variance[i] > darkest else _NOTHING) | (_INDIRECT if indirect else _NOTHING)


@compiled
def flag_inverted_bits(
    variance: Floats32,
    at_black: np.float32,
    per_level: np.float32,
    white: Floats32,
    threshold: Floats32,
    least: Floats32,
    flags: Reasons,
) -> None:
    """Flag pixels where global light exceeds direct light by at least a bit's contrast, and may have inverted the bit.

    `least` (P,): smallest contrast of a code's bits (Xu and Aliaga, 2007).
    """
    for i in range(len(flags)):
        power = (at_black + per_level * threshold[i]) / variance[i]
        excess = _TWO * (white[i] - threshold[i]) - _FOUR * np.sqrt(power)
        flags[i] |= _INDIRECT if (excess > _ZERO) & (least[i] <= excess) else _NOTHING


@compiled
def flag_contrast(
    least: Floats32, least_certain: Floats32, contrast: Floats32, least_seen: Floats32, flags: Reasons
) -> None:
    """Flag pixels where a code's smallest contrast is too small to decide its bit, or its largest
    is within the noise.
    """
    for i in range(len(flags)):
        flags[i] |= (_UNDECIDED if least[i] <= least_certain[i] else _NOTHING) | (
            _DARK if contrast[i] <= least_seen[i] else _NOTHING
        )
