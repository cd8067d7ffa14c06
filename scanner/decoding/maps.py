"""What was accumulated → the coordinates of all pixels, strip by strip, with all that needs a pixel's neighbours."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.arrays import Bools, Ints
from scanner.decoding.accumulate import Accumulators, FringeFold
from scanner.decoding.arrays import Floats32, Reasons
from scanner.decoding.continuity import breaks
from scanner.decoding.coordinate import AxisDecoder, Coordinate, MaskReason, Signals
from scanner.decoding.plan import AxisPlan
from scanner.decoding.shading import UNCERTAIN_SHARE, footprint_variance, shift_per_variance
from scanner.decoding.strips import in_strips
from scanner.decoding.systematic import BLOCK_PX

# Rows beyond a strip that its pixels depend on: whole blocks, so that these are the same ones in every strip.
_HALO = 2 * BLOCK_PX
_TILE_PX = 48
_MOST_TILES = 48


@dataclass(frozen=True)
class Maps:
    """Of all camera pixels (H, W): both coordinates `x`, `y` in projector pixels, the mean `variance` of the two, the
    `reason` not to use them, and whether they are `broken`: do not continue their neighbours'. `counts` (2, reasons):
    how many pixels of x and of y have each reason.
    """

    x: Floats32
    y: Floats32
    variance: Floats32
    reason: Reasons
    broken: Bools
    counts: Ints


def signals_of(accumulators: Accumulators, select: Callable[[NDArray[Any]], NDArray[Any]]) -> tuple[Signals, Signals]:
    """The accumulated signals of x and y at some pixels; `select` takes these from an (H, W) image, as a 2-D array."""

    def of_axis(axis: AxisPlan) -> Signals:
        codes = [fold for fold in accumulators.codes if fold.code in axis.codes]
        fringes = [fold for fold in accumulators.fringes if fold.fringe in axis.fringes]
        return Signals(
            [select(fold.words) for fold in codes],
            [select(fold.least) for fold in codes if not axis.corrects_bits],
            [select(fold.contrast) for fold in codes if fold.contrast is not None],
            [(_in_levels(select(fold.cosine), fold), _in_levels(select(fold.sine), fold)) for fold in fringes],
            select(accumulators.brightest),
            select(accumulators.middle),
            select(accumulators.peak),
            None if accumulators.log_exposure is None else select(accumulators.log_exposure),
        )

    return of_axis(accumulators.plan.x), of_axis(accumulators.plan.y)


def _in_levels(component: NDArray[Any], fold: FringeFold) -> Floats32:
    levels: Floats32 = component.astype(np.float32)
    levels *= np.float32(fold.scale)
    return levels


def coordinate_maps(accumulators: Accumulators, decoders: tuple[AxisDecoder, AxisDecoder]) -> Maps:
    """Both coordinates of all pixels."""
    shape = accumulators.middle.shape
    footprint_px2 = _footprint(accumulators, decoders)
    x, y, variance = (np.empty(shape, np.float32) for _ in range(3))
    reasons, broken = np.empty(shape, np.uint8), np.empty(shape, np.bool_)

    def decode(rows: slice) -> Ints:
        above, below = min(rows.start, _HALO), min(shape[0] - rows.stop, _HALO)
        wider = slice(rows.start - above, rows.stop + below)
        inner = slice(above, above + rows.stop - rows.start)
        found = [
            decoder.decode(part)
            for decoder, part in zip(decoders, signals_of(accumulators, lambda image: image[wider]), strict=True)
        ]
        reason = _first_reason(found)
        kept = reason == MaskReason.KEPT
        for coordinate in found:
            _straighten(coordinate, kept, footprint_px2)
        x[rows], y[rows] = (coordinate.value[inner] for coordinate in found)
        variance[rows] = np.float32(0.5) * (found[0].variance[inner] + found[1].variance[inner])
        reasons[rows] = reason[inner]
        broken[rows] = breaks(kept, found, accumulators.plan.axes)[inner]
        return np.array([[np.count_nonzero(c.reason[inner] == reason) for reason in MaskReason] for c in found])

    counts = np.sum(in_strips(shape[0], decode), axis=0)
    return Maps(x, y, variance, reasons, broken, counts)


def _first_reason(coordinates: list[Coordinate]) -> Reasons:
    """The first of two reasons is the smaller number; KEPT, which is 0, becomes the largest in between."""
    x, y = (coordinate.reason for coordinate in coordinates)
    reason: Reasons = np.minimum(x - np.uint8(1), y - np.uint8(1)) + np.uint8(1)
    return reason


def _straighten(coordinate: Coordinate, kept: Bools, footprint_px2: float) -> None:
    """Take out what shading shifts, and be less sure of what was shifted; in place."""
    if coordinate.log_amplitude is None or footprint_px2 == 0:
        return
    shift = shift_per_variance(coordinate.value, coordinate.log_amplitude, kept)
    shift *= np.float32(footprint_px2)
    np.subtract(coordinate.value, shift, out=coordinate.value)
    shift *= shift
    shift *= np.float32(UNCERTAIN_SHARE**2)
    np.add(coordinate.variance, shift, out=coordinate.variance)


def _footprint(accumulators: Accumulators, decoders: tuple[AxisDecoder, AxisDecoder]) -> float:
    """The variance of a camera pixel's footprint, from tiles spread over the lit part of the image."""
    height, width = accumulators.middle.shape
    rows, columns = (np.arange(0, size - _TILE_PX + 1, _TILE_PX) for size in (height, width))
    corners = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    if not accumulators.fringes or not len(corners):
        return 0.0
    middles = tuple((corners + _TILE_PX // 2).T)
    at_middles = signals_of(accumulators, lambda image: image[middles][None])
    lit = np.ones(len(corners), np.bool_)
    for decoder, part in zip(decoders, at_middles, strict=True):
        if decoder.plan.fringes:
            lit &= decoder.well_lit(part)[0]
    corners = corners[lit]
    corners = corners[np.linspace(0, len(corners) - 1, min(len(corners), _MOST_TILES)).astype(np.int64)]
    if not len(corners):
        return 0.0

    def tiles(image: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate([image[row : row + _TILE_PX, column : column + _TILE_PX] for row, column in corners])

    parts = signals_of(accumulators, tiles)
    found = [decoder.decode(part) for decoder, part in zip(decoders, parts, strict=True)]
    usable = _first_reason(found) == MaskReason.KEPT
    shaded = [(c.value, c.log_amplitude) for c in found if c.log_amplitude is not None]
    log_lit = np.log(np.maximum(parts[0].brightest, 1).astype(np.float32))
    if parts[0].log_exposure is not None:
        log_lit -= parts[0].log_exposure
    return footprint_variance(shaded, log_lit, usable, _TILE_PX)
