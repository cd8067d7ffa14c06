"""Decode the coordinates of all pixels, tile by tile, including the steps that need a pixel's neighbours.

The camera-to-projector map is smooth on a surface. At an occlusion edge a pixel sees two surfaces and its phase belongs
to neither; a code error is an isolated outlier. Pixels that do not continue the surface of their neighbours are masked,
and so are patches too small for a surface: few pixels that agree are outliers that happen to touch.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log, pi, sqrt
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.numerics import (
    Bools,
    Floats32,
    Ints,
    compiled,
    evenly_spread,
    in_parallel,
    in_slices,
    in_tiles,
    widened,
)
from scanner.decoding.codes import BEND_OF_SLOPE
from scanner.decoding.coordinates.axis_decoder import AxisDecoder, Coordinate, FringeAxis
from scanner.decoding.coordinates.code_images import CodeImages, signals_in, signals_of
from scanner.decoding.fringes import (
    BLOCK_PX,
    CROSS,
    MOST_BEND_PX,
    REACH_PX,
    TYPICAL_PX2,
    Footprint,
    correct_curvature_shift,
    correct_shading_shift,
    footprint_of,
    surrounded,
)
from scanner.decoding.mask_reasons import CONTRADICTIONS, MaskReason, Reasons, count_reasons
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


# Margin around a tile that its pixels depend on: whole blocks, so that these are the same in every tile.
_HALO = BLOCK_PX * -(-(REACH_PX + 1) // BLOCK_PX)  # plus one for discontinuities
# Reasons that motion causes: an object close to the rig is brighter than the static scene.
_OF_MOTION = (*CONTRADICTIONS, MaskReason.SATURATED)
_TILE_PX, _MOST_TILES = 48, 48  # tiles for the footprint of a pixel
_HALF, _UNKNOWN = np.float32(0.5), np.float32(np.nan)


@dataclass(frozen=True)
class CoordinateMap:
    """Coordinates of all camera pixels. No step edits one: each returns another, which may share arrays."""

    projector_px: Floats32
    """(H, W, 2): NaN where one coordinate is unknown."""
    variance: Floats32
    """(H, W): mean over the measured axes."""
    reason: Reasons
    """(H, W): for masking the pixel, a `MaskReason`."""
    counts: Ints
    """(2, reasons): number of pixels of x and of y with each of the `CONTRADICTIONS`."""
    footprint_px2: float = 0.0
    """Variance of a camera pixel's footprint along its principal axis."""

    def masked_as(self, reason: MaskReason) -> Bools:
        """Return the pixels (H, W) that are masked for a reason, or kept."""
        masked: Bools = self.reason == np.uint8(reason)
        return masked

    def masked(self, where: Bools, reason: MaskReason) -> "CoordinateMap":
        """Return the map with the pixels chosen (H, W) masked for a reason."""
        return replace(self, reason=np.where(where, np.uint8(reason), self.reason))

    def without(self, where: Bools) -> "CoordinateMap":
        """Return the map with unknown coordinates at the pixels chosen (H, W)."""
        projector_px = self.projector_px.copy()
        projector_px[where] = np.nan
        return replace(self, projector_px=projector_px)


def decode_tiles(
    code_images: CodeImages,
    decoders: tuple[AxisDecoder, AxisDecoder],
    moved: Bools | None = None,
    corrupted: Bools | None = None,
) -> CoordinateMap:
    """Decode both coordinates of all pixels. Without fringes, discontinuities are not masked, as cells have steps.

    `moved` (H, W): where something moved, which explains contradictions and saturation. `corrupted` (H, W): pixels to
    mask for it in any case.
    """
    plan, (height, width) = code_images.plan, code_images.threshold.shape
    footprint = _footprint(code_images, decoders)
    projector_px, variance = np.empty((height, width, 2), np.float32), np.empty((height, width), np.float32)
    reasons = np.empty((height, width), np.uint8)

    def decode(rows: slice, columns: slice) -> Ints:
        (wide_rows, own_rows), (wide_columns, own_columns) = (
            widened(part, _HALO, size) for part, size in ((rows, height), (columns, width))
        )
        wide, own = (wide_rows, wide_columns), (own_rows, own_columns)
        # Lazily, so that the signals of x are freed before those of y are made.
        coordinates = list(map(lambda axis, signals: axis.decode(signals), decoders, signals_in(code_images, wide)))
        if moved is not None and corrupted is not None:
            for c in coordinates:
                why = (corrupted[wide] & (c.reason != MaskReason.DARK)) | (moved[wide] & np.isin(c.reason, _OF_MOTION))
                np.copyto(c.reason, np.uint8(MaskReason.MOVED), where=why)
        reason = _first_reason(coordinates)
        kept = reason == np.uint8(MaskReason.KEPT)
        shaded = [
            (c, correct_shading_shift(c.value, c.variance, c.log_amplitude, kept, footprint))
            for c in coordinates
            if c.log_amplitude is not None
        ]
        for c in coordinates:
            _forget(c.value.ravel(), kept.ravel())
        if plan.fringes:
            np.copyto(reason, np.uint8(MaskReason.ISOLATED), where=kept & breaks(kept, coordinates, plan.axes))
            surface = reason == np.uint8(MaskReason.KEPT)
            for c, shift in shaded:
                correct_curvature_shift(c.value, c.variance, shift, surface, footprint, own)
        measured = [c.variance for c, axis in zip(coordinates, plan.axes, strict=True) if axis.is_measured]
        corners = own_rows.start, own_columns.start, rows.start, rows.stop, columns.start, columns.stop
        _note(coordinates[0].value, coordinates[1].value, measured[0], measured[-1], corners, projector_px, variance)
        reasons[rows, columns] = reason[own]
        return np.stack([count_reasons(c.reason[own], CONTRADICTIONS) for c in coordinates])

    counts = np.sum(in_tiles((height, width), decode), axis=0)
    return CoordinateMap(projector_px, variance, reasons, counts, max(footprint.largest_px2, 0.0))


@compiled
def _forget(value: Floats32, kept: Bools) -> None:
    """Set the values (P,) that are not kept to NaN."""
    for i in range(len(value)):
        value[i] = value[i] if kept[i] else _UNKNOWN


@compiled
def _note(
    x: Floats32,
    y: Floats32,
    first: Floats32,
    second: Floats32,
    corners: tuple[int, int, int, int, int, int],
    projector_px: Floats32,
    variance: Floats32,
) -> None:
    """Store a tile's coordinates, and the mean of two variances, (h, w), in the whole images, (H, W, 2) and (H, W).

    `corners`: of what is stored, the first row and column within the tile, and the rows and columns of the image. Rows
    of whole images are contiguous, which vectorised loops need.
    """
    from_row, from_column, top, bottom, first_column, right = corners
    width = right - first_column
    for row in range(bottom - top):
        of_x, of_y = x[from_row + row, from_column:], y[from_row + row, from_column:]
        of_first, of_second = first[from_row + row, from_column:], second[from_row + row, from_column:]
        px, mean = projector_px[top + row, first_column:], variance[top + row, first_column:]
        for i in range(width):
            px[i, 0], px[i, 1] = of_x[i], of_y[i]
        for i in range(width):
            mean[i] = _HALF * (of_first[i] + of_second[i])


def _first_reason(coordinates: list[Coordinate]) -> Reasons:
    """Return the smaller nonzero of two reasons; the subtraction of 1 turns KEPT, which is 0, into
    the largest value.
    """
    x, y = (coordinate.reason for coordinate in coordinates)
    reason: Reasons = np.minimum(x - np.uint8(1), y - np.uint8(1)) + np.uint8(1)
    return reason


def _footprint(code_images: CodeImages, decoders: tuple[AxisDecoder, AxisDecoder]) -> Footprint:
    """Estimate a camera pixel's footprint from tiles spread over the lit part of the image."""
    height, width = code_images.threshold.shape
    rows, columns = (np.arange(0, size - _TILE_PX + 1, _TILE_PX) for size in (height, width))
    corners = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    if not code_images.plan.fringes or not len(corners):
        return Footprint.round(TYPICAL_PX2)
    middle = _TILE_PX // 2
    middles = slice(middle, rows[-1] + _TILE_PX, _TILE_PX), slice(middle, columns[-1] + _TILE_PX, _TILE_PX)
    lit = np.ones(len(corners), np.bool_)
    for decoder, at_middles in zip(decoders, signals_in(code_images, middles), strict=True):
        if isinstance(decoder, FringeAxis):
            lit &= decoder.measure(at_middles).well_lit
    corners = evenly_spread(corners[lit], _MOST_TILES)
    if not len(corners):
        return Footprint.round(TYPICAL_PX2)

    parts = [(slice(row, row + _TILE_PX), slice(column, column + _TILE_PX)) for row, column in corners.tolist()]
    frames = [dict(code_images.frames.by_number(part, code_images.plan.fringe_frames)) for part in parts]

    def tiles(image: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate([image[part] for part in parts])

    signals = signals_of(code_images, tiles, lambda frame: np.concatenate([of_part[frame] for of_part in frames]))
    both = zip(decoders, signals, strict=True)
    coordinates = in_parallel(lambda axis: axis[0].decode(axis[1]), both)
    usable = _first_reason(coordinates) == np.uint8(MaskReason.KEPT)
    shaded = [(c.value, c.log_amplitude) for c in coordinates if c.log_amplitude is not None]
    log_lit = np.log(np.maximum(tiles(code_images.white), 1).astype(np.float32))
    if code_images.log_exposure is not None:
        log_lit -= tiles(code_images.log_exposure)
    # With three steps, harmonics ripple amplitude and phase alike: a correlation of the two is not shading alone.
    rippled = any(len(fringe.shifts) == 3 for decoder in decoders for fringe in decoder.plan.fringes)
    return footprint_of(shaded, log_lit, usable, _TILE_PX, 0.0 if rippled else TYPICAL_PX2)
