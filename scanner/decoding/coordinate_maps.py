"""Decode the coordinates of all pixels, tile by tile, including the steps that need a pixel's neighbours."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.numerics import Bools, Floats32, Ints, Part, compiled, evenly_spread, in_parallel, in_tiles, widened
from scanner.decoding.axis_decoder import AxisDecoder, Coordinate
from scanner.decoding.code_images import CodeImages, signals_in, signals_of
from scanner.decoding.discontinuities import breaks
from scanner.decoding.fringes.footprint import TYPICAL_PX2, footprint_of
from scanner.decoding.fringes.footprint_shift import REACH_PX, Footprint, correct_curvature_shift, correct_shading_shift
from scanner.decoding.fringes.systematic_error import BLOCK_PX
from scanner.decoding.mask_reasons import CONTRADICTIONS, MaskReason, Reasons, count_reasons

# Margin around a tile that its pixels depend on: whole blocks, so that these are the same in every tile.
_HALO = BLOCK_PX * -(-(REACH_PX + 1) // BLOCK_PX)  # plus one for discontinuities
# Reasons that motion causes: an object close to the rig is brighter than the static scene.
_OF_MOTION = (*CONTRADICTIONS, MaskReason.SATURATED)
_TILE_PX, _MOST_TILES = 48, 48  # tiles for the footprint of a pixel
_HALF, _UNKNOWN = np.float32(0.5), np.float32(np.nan)


@dataclass(frozen=True)
class Maps:
    """Coordinates of all camera pixels."""

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

    def within(self, part: Part) -> "Maps":
        """Return a view of a part of the image."""
        images = self.projector_px[part], self.variance[part], self.reason[part]
        return Maps(*images, self.counts, self.footprint_px2)


def coordinate_maps(
    code_images: CodeImages,
    decoders: tuple[AxisDecoder, AxisDecoder],
    moved: Bools | None = None,
    corrupted: Bools | None = None,
) -> Maps:
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
        coordinates = list(map(AxisDecoder.decode, decoders, signals_in(code_images, wide)))
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
    return Maps(projector_px, variance, reasons, counts, max(footprint.largest_px2, 0.0))


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
        if decoder.plan.fringes:
            lit &= decoder.measure(at_middles).well_lit
    corners = evenly_spread(corners[lit], _MOST_TILES)
    if not len(corners):
        return Footprint.round(TYPICAL_PX2)

    parts = [(slice(row, row + _TILE_PX), slice(column, column + _TILE_PX)) for row, column in corners.tolist()]
    frames = [dict(code_images.equalised(part, code_images.plan.fringe_frames)) for part in parts]

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
