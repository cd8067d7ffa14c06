"""Find pixels that do not continue the surface of their neighbours, and patches that are too small for a surface.

At an occlusion edge a pixel sees two surfaces and its phase belongs to neither; a code error is an isolated outlier.
Both are discontinuities of the camera-to-projector map, which is smooth on a surface. Few pixels that agree are
outliers that happen to touch.
"""

from collections.abc import Sequence
from math import log, pi, sqrt
from typing import cast

import cv2
import numpy as np

from calib.numerics import Bools, Floats32, compiled, in_slices, widened
from scanner.decoding.axis_decoder import Coordinate
from scanner.decoding.codes.edge_interpolation import BEND_OF_SLOPE
from scanner.decoding.fringes.footprint_shift import CROSS, MOST_BEND_PX, surrounded
from scanner.decoding.sequence_plan import AxisPlan
from scanner.decoding.significance import OUTLYING_SIGMAS, SIGNIFICANT_SIGMAS

SMALLEST_PATCH = 24  # pixels; fewer are taken for outliers that happen to touch
_ROWS = 512  # at once, of which twice the smallest patch is searched twice
_WITHIN = np.ones((5, 5), np.uint8)  # a square of more pixels


def breaks(
    kept: Bools, coordinates: Sequence[Coordinate], axes: Sequence[AxisPlan], *, between_edges: bool = False
) -> Bools:
    """Return the pixels (H, W) that break the map of any axis, or that lack `kept` neighbours on opposite sides.

    Coordinates of other pixels are NaN. `between_edges`: coordinates from codes were interpolated and have no steps.
    """
    broken: Bools = ~np.any([surrounded(kept, np.ones(line, np.uint8)) for line in ((3, 1), (1, 3))], axis=0)
    for coordinate, axis in zip(coordinates, axes, strict=True):
        value, variance, amplitude = coordinate.value, coordinate.variance, coordinate.log_amplitude
        # Neighbouring pixels may be two Gray code cells apart, whatever the variance.
        smooth = between_edges or axis.fringes
        # Largest second difference of a surface: a share of the first difference, plus this much.
        least, sigmas = (MOST_BEND_PX, SIGNIFICANT_SIGMAS * sqrt(6)) if smooth else (MOST_BEND_PX + 2 * axis.cell, 0.0)
        for down, across in ((1, 0), (0, 1)):
            limits = np.array([BEND_OF_SLOPE, least, sigmas], np.float32)
            _note_bends(value, variance, limits, down, across, broken)
        if amplitude is not None:
            # The noise of a phase in radians is the relative noise of its amplitude.
            relative = np.float32(OUTLYING_SIGMAS * 2 * pi / axis.fringes[-1].period)
            largest = cast(Floats32, cv2.dilate(amplitude, np.ones((3, 3), np.uint8)))
            faint = np.empty(kept.size, np.bool_)
            _note_faint(amplitude.ravel(), largest.ravel(), variance.ravel(), relative, faint)
            broken |= cv2.dilate(faint.reshape(kept.shape).view(np.uint8), CROSS).view(np.bool_)
    return broken


@compiled
def _note_bends(value: Floats32, variance: Floats32, limits: Floats32, down: int, across: int, broken: Bools) -> None:
    """Flag second differences along rows or columns that exceed curvature and noise.

    `limits`: share of the first difference, projector pixels, and standard deviations that are allowed.

    NaN neighbours flag nothing.
    """
    height, width = value.shape
    of_slope, least, sigmas = limits[0], limits[1], limits[2]
    for row in range(down, height - down):
        before, after = value[row - down, : width - 2 * across], value[row + down, 2 * across :]
        middle = slice(across, width - across)
        of_row, noise, note = value[row, middle], variance[row, middle], broken[row, middle]
        for i in range(len(of_row)):
            bend = abs(before[i] + after[i] - of_row[i] - of_row[i]) - of_slope * abs(after[i] - before[i])
            note[i] |= bend > least + sigmas * np.sqrt(noise[i])


@compiled
def _note_faint(
    log_amplitude: Floats32, largest: Floats32, variance: Floats32, sigmas: np.float32, faint: Bools
) -> None:
    """Flag pixels whose fringes are much weaker than a neighbour's.

    At the edge of the light, or of a dark patch, lens blur mixes in light from beside the pixel. Where the amplitude
    halves from one pixel to the next, this shifts the coordinate by up to half a pixel.
    """
    for i in range(len(faint)):
        faint[i] = log_amplitude[i] < largest[i] - (np.float32(log(2)) + sigmas * np.sqrt(variance[i]))


def small_patches(image: Bools) -> Bools:
    """Return the pixels of an image (H, W) in 4-connected components of fewer than `SMALLEST_PATCH` pixels."""
    result = np.empty_like(image)

    def find(rows: slice) -> None:
        # A component that reaches beyond the widened rows is not small.
        wider, inner = widened(rows, SMALLEST_PATCH, len(image))
        part = image[wider].view(np.uint8)
        # Few pixels are not in a square that is part of their component: only these have to be connected.
        large = cv2.morphologyEx(part, cv2.MORPH_OPEN, _WITHIN, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        rest = np.subtract(part, large)
        _, labels = cv2.connectedComponents(rest, connectivity=4)
        places = np.flatnonzero(rest)
        label, beside = (of.reshape(-1)[places] for of in (labels, cv2.dilate(large, CROSS)))
        small = np.bincount(label) < SMALLEST_PATCH
        small[label[beside > 0]] = False
        rest.reshape(-1)[places] = small[label]
        result[rows] = rest[inner]

    in_slices(len(image), _ROWS, find)
    return result
