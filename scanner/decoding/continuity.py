"""Pixels that do not continue the surface that their neighbours see.

At an occlusion edge a pixel sees two surfaces and its phase is that of neither; an error in a code is an island. Both
break the map from camera to projector, which is smooth on a surface.
"""

from collections.abc import Sequence
from math import log, pi, sqrt

import cv2
import numpy as np

from calib.arrays import Bools
from scanner.decoding.arrays import Floats32
from scanner.decoding.coordinate import Coordinate
from scanner.decoding.plan import AxisPlan
from scanner.decoding.strips import in_strips

_SIGMAS = 5.0
# A surface may bend by this much of its slope, and this many projector pixels, from one camera pixel to the next.
_BEND_OF_SLOPE = 0.5
_BEND_PX = 1.0
_SMALLEST_PATCH = 24
_PATCH_ROWS = 512
# Where the amplitude halves from one pixel to the next, the lens shifts the coordinate by up to half a pixel.
_FAINTER = 2.0
_FAINT_SIGMAS = 3.0
# A pixel's neighbours on opposite sides, along columns and along rows.
_LINES = ((np.s_[:-2, :], np.s_[1:-1, :], np.s_[2:, :]), (np.s_[:, :-2], np.s_[:, 1:-1], np.s_[:, 2:]))


def breaks(kept: Bools, coordinates: Sequence[Coordinate], axes: Sequence[AxisPlan]) -> Bools:
    """Which pixels (H, W) break the map of any axis, or cannot be compared with `kept` ones on opposite sides."""
    broken = np.ones(kept.shape, np.bool_)
    for before, middle, after in _LINES:
        broken[middle] &= ~(kept[before] & kept[after])
    for coordinate, axis in zip(coordinates, axes, strict=True):
        value = np.where(kept, coordinate.value, np.float32(np.nan))
        sigma = np.sqrt(coordinate.variance)
        if coordinate.log_amplitude is None:
            _note_bends(value, np.full_like(sigma, 2 * axis.cell), broken)
            continue
        _note_bends(value, np.float32(_SIGMAS * sqrt(6)) * sigma, broken)
        # In radians the noise of a phase is the relative noise of its amplitude.
        sigma *= np.float32(2 * pi / axis.fringes[-1].period)
        broken |= _on_rim(coordinate.log_amplitude, sigma)
    return broken


def isolated(kept: Bools, broken: Bools) -> Bools:
    """Which of the `kept` pixels (H, W) are `broken`, or are left on small patches between breaks."""
    height = len(kept)
    result = np.empty_like(kept)

    def find(rows: slice) -> None:
        # A patch that reaches from these rows to beyond the wider ones is not small.
        first, last = max(0, rows.start - _SMALLEST_PATCH), min(height, rows.stop + _SMALLEST_PATCH)
        whole = kept[first:last] & ~broken[first:last]
        _, patches, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(
            whole.view(np.uint8), 4, cv2.CV_32S, cv2.CCL_SPAGHETTI
        )
        is_large = stats[:, cv2.CC_STAT_AREA] >= _SMALLEST_PATCH
        is_large[0] = False
        inner = slice(rows.start - first, rows.stop - first)
        np.greater(kept[rows], is_large[patches[inner]], out=result[rows])

    in_strips(height, find, rows=_PATCH_ROWS)
    return result


def _note_bends(value: Floats32, slack: Floats32, broken: Bools) -> None:
    """Where the second difference along a row or a column is more than curvature and `slack` explain.

    A neighbour that is NaN explains nothing and breaks nothing.
    """
    slack += np.float32(_BEND_PX)
    for before, middle, after in _LINES:
        bend = value[before] + value[after]
        bend -= value[middle]
        bend -= value[middle]
        np.abs(bend, out=bend)
        slope = value[after] - value[before]
        np.abs(slope, out=slope)
        slope *= np.float32(_BEND_OF_SLOPE / 2)
        bend -= slope
        broken[middle] |= bend > slack[middle]


def _on_rim(log_amplitude: Floats32, noise: Floats32) -> Bools:
    """Where the fringes are much weaker than next door, and next to that; `noise` is that of the logarithm.

    At the edge of the light, or of a dark patch, the lens mixes in light from beside the pixel.
    """
    largest = cv2.dilate(log_amplitude, np.ones((3, 3), np.uint8))
    faint = log_amplitude < largest - (np.float32(log(_FAINTER)) + np.float32(_FAINT_SIGMAS) * noise)
    return cv2.dilate(faint.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))) > 0
