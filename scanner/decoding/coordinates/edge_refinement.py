"""With Gray codes only: coordinates between sub-pixel stripe edges in place of cell centres, and their roughness.

Neighbouring coordinates are as smooth as their codes or noise allow. With codes alone, a surface becomes a staircase
with the steps of a cell, whose residuals from a smooth surface are the cell's length over √12. Finest bits that do not
belong to the others, because something moved or frames were duplicated or exchanged, more than double this roughness,
whether or not the camera resolves single cells.

Fringes and stripe edges have a sigma from noise. If the residuals are larger, for example from lossy image compression,
the sigma is raised to match them.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import sqrt

import cv2
import numpy as np

from calib.numerics import (
    STRIP_ROWS,
    Bools,
    Floats,
    Floats32,
    Ints,
    Window,
    around,
    compiled,
    evenly_spread,
    in_slices,
    lines_of,
    widened,
)
from scanner.decoding.codes import CELLS_PER_PIXEL, CodeWords, StripeLevels, interpolate
from scanner.decoding.coordinates.axis_decoder import Coordinate, largest_variance, least_contrasts
from scanner.decoding.coordinates.code_images import CodeImages
from scanner.decoding.coordinates.coordinate_map import CoordinateMap, breaks
from scanner.decoding.light import NoiseModel
from scanner.decoding.mask_reasons import MaskReason, Reasons
from scanner.decoding.sequence_plan import AxisPlan, GrayCode, SequencePlan
from scanner.decoding.significance import HALF
from scanner.errors import InputError

# Size of tiles, with 24 pixels per coefficient of a quadratic surface; candidates along each side of the image; the
# fewest and the most for a median ratio.
_TILE_PX, _GRID, _FEWEST_TILES, _MOST_TILES = 12, 64, 20, 100
# Largest residual variance, relative to that of a cell: 1 for a staircase, less where pixels average over cells, up to
# 3 where a nonlinear camera without inverse patterns narrows every second stripe; 5 and more for wrong bits.
_MOST = 4.0
# Relative to the noise variance: at most 1.06 in simulated rooms, whatever their texture; up to 1.8 of JPEG at a
# quality of 95, 1.2 to 1.6 of films.
_MOST_OF_FRINGES = 1.15


def check_roughness(plan: SequencePlan, maps: CoordinateMap) -> None:
    """Raise InputError if coordinates from codes alone are much rougher than their cells."""
    if plan.fringes or plan.only_axis is not None:
        return
    for axis, relative in zip(plan.axes, _roughness(maps), strict=True):
        if relative > _MOST:
            raise InputError(
                f"along {axis.axis} the cells of the Gray code do not follow each other: they are {axis.cell:g} px "
                f"long, but pixels next to each other jump to and fro by {np.sqrt(relative / 12) * axis.cell:.1f} px. "
                f"Did something move in between, or were frames exchanged or repeated? {plan.names(_finest(axis))}"
            )


def widen_by_roughness(plan: SequencePlan, maps: CoordinateMap) -> CoordinateMap:
    """Return the map with the variance of fringe coordinates raised to the scatter of neighbours, and pixels too noisy
    then masked as dark.
    """
    if not plan.fringes or plan.only_axis is not None:
        return maps
    relative = float(np.mean(_roughness(maps)))
    if relative < _MOST_OF_FRINGES:
        return maps
    variance = maps.variance * np.float32(relative)
    just_seen = [largest_variance(axis.fringes[0], with_gray=bool(axis.codes)) for axis in plan.axes if axis.fringes]
    dark = maps.masked_as(MaskReason.KEPT) & (variance > np.float32(np.mean(just_seen)))
    return replace(maps, variance=variance).masked(dark, MaskReason.DARK).without(dark)


def widen_between_edges(plan: SequencePlan, maps: CoordinateMap) -> CoordinateMap:
    """Return the map with the variance of coordinates between stripe edges raised to the scatter of neighbours.

    The unknown shape of edges, due to the lens or camera software, exceeds the noise in good light.
    """
    if plan.only_axis is not None:
        return maps
    return replace(maps, variance=maps.variance * np.float32(max(1.0, float(np.mean(_roughness(maps))))))


def _roughness(maps: CoordinateMap) -> tuple[float, float]:
    """Return for x and y the median ratio of residual variance in small tiles to the stated one; 0 if there are few."""
    pixels = _in_tiles(maps)
    coordinates = maps.projector_px.reshape(-1, 2)[pixels].astype(np.float64)
    variance = maps.variance.reshape(-1)[pixels]
    known = np.isfinite(coordinates).all(axis=2) & (maps.reason.reshape(-1)[pixels] == 0)
    enough = known.mean(axis=1) > HALF
    if np.count_nonzero(enough) < _FEWEST_TILES:
        return 0.0, 0.0
    coordinates, variance, known = coordinates[enough], variance[enough], known[enough]
    square = _residual_squares(np.where(known[..., None], coordinates, 0.0), known)
    cells = np.sum(np.where(known, variance, 0), axis=1)
    x, y = np.median(square / cells[:, None], axis=0)
    return float(x), float(y)


def _in_tiles(maps: CoordinateMap) -> Ints:
    """Return the pixels (T, P) of some tiles that are mostly decoded, even if these are a small part of the image."""
    height, width = maps.reason.shape
    rows, columns = (np.linspace(0, n - _TILE_PX, min(_GRID, n // _TILE_PX)).astype(np.int64) for n in (height, width))
    corners = (rows[:, None] * width + columns).reshape(-1)
    within = (np.arange(_TILE_PX)[:, None] * width + np.arange(_TILE_PX)).reshape(-1)
    some = within[:: _TILE_PX // 2 + 1]  # in all rows and columns
    kept = maps.reason.reshape(-1)[corners[:, None] + some] == np.uint8(MaskReason.KEPT)
    corners = corners[kept.mean(axis=1) > HALF]
    pixels: Ints = evenly_spread(corners, _MOST_TILES)[:, None] + within
    return pixels


def _residual_squares(coordinates: Floats, known: np.ndarray) -> Floats:
    """Return the residual sums of squares (T, 2) of quadratic fits to the `known` (T, P) coordinates (T, P, 2) of
    tiles.
    """
    v, u = np.mgrid[:_TILE_PX, :_TILE_PX] - (_TILE_PX - 1) / 2
    u, v = u.ravel() / _TILE_PX, v.ravel() / _TILE_PX
    terms = np.stack([np.ones(u.size), u, v, u * u, u * v, v * v], axis=1)
    weighted = terms.T * known[:, None, :]
    surfaces = np.linalg.solve(weighted @ terms, weighted @ coordinates)
    residual = (coordinates - terms @ surfaces) * known[..., None]
    squares: Floats = np.sum(residual**2, axis=1)
    return squares


def _finest(axis: AxisPlan) -> list[int]:
    """Return the frames of the finest bits of an axis."""
    return min(axis.codes, key=lambda code: code.cell).fine_frames


# In cells longer than this many camera pixels, a pixel that is not between edges lies in a cut-off cell.
_LONG_PX = 2.0
# Number of certain pixels, of 8 neighbours, around an undecided pixel at an edge.
_FEWEST_AROUND = 4
_KEPT, _UNDECIDED, _ISOLATED = (
    np.uint8(reason) for reason in (MaskReason.KEPT, MaskReason.UNDECIDED, MaskReason.ISOLATED)
)


def refine_by_edges(
    code_images: CodeImages, maps: CoordinateMap, noise: NoiseModel, undecided: Bools
) -> CoordinateMap | None:
    """Return the map with coordinates interpolated between stripe edges; None if too few pixels lie between edges.

    Pixels that were `undecided` (H, W) are kept if they lie between edges. A pixel that is not between edges along an
    axis keeps its cell's centre there, if the cell is short and continues the pixels around it.
    """
    measured = [number for number, axis in enumerate(code_images.plan.axes) if axis.is_measured]
    all_words = [
        code_words for number in measured if (code_words := code_images.with_edges(code_images.plan.axes[number]))
    ]
    if len(all_words) < len(measured):
        return None
    usable = _usable(maps, undecided)
    if not usable.any():
        return None
    refined = _between_edges(code_images, maps, noise, usable, dict(zip(measured, all_words, strict=True)))
    if refined is None:
        return None
    return widen_between_edges(code_images.plan, _without_breaks(code_images.plan, refined))


def _between_edges(
    code_images: CodeImages, maps: CoordinateMap, noise: NoiseModel, usable: Bools, words: Mapping[int, CodeWords]
) -> CoordinateMap | None:
    """Interpolate the coordinates of `usable` pixels (H, W); None if fewer than half of the kept ones lie between some.

    `words`: of the code with edges of each measured axis, by its number.
    """
    part = around(usable)
    usable, kept = usable[part], maps.masked_as(MaskReason.KEPT)[part]
    grey = np.arange(np.iinfo(code_images.threshold.dtype).max + 1.0)
    least, _ = least_contrasts(noise, grey)
    light = code_images.threshold[part], code_images.white[part]
    refined = replace(
        maps, projector_px=maps.projector_px.copy(), variance=maps.variance.copy(), reason=maps.reason.copy()
    )
    values = [refined.projector_px[part][..., number] for number in words]
    variances = np.empty((len(words), *kept.shape), np.float32)
    for code_words, *into in zip(words.values(), values, variances, strict=True):
        code = code_words.code
        levels = _levels_of(code_images, code, part)
        interpolate(code_words.words[part], usable, light, levels, least, noise.at_black + noise.gain * grey, into)
        _in_projector_px(code, *into)
    between = np.logical_and.reduce([np.isfinite(of_axis) for of_axis in variances])
    # With fewer pixels between edges, cell centres are kept everywhere.
    if np.count_nonzero(between & kept) < max(1.0, HALF * np.count_nonzero(kept)):
        return None
    apart = np.array(
        [_apart(v, code_words.code.cell) for v, code_words in zip(values, words.values(), strict=True)], np.float32
    )
    by_cells = maps.projector_px[part], maps.variance[part], maps.reason[part]
    by_edges = refined.projector_px[part], refined.variance[part], refined.reason[part]
    _fill_in_cells(by_cells, variances, np.array([*words]), apart, usable, by_edges)
    return refined


def _usable(maps: CoordinateMap, undecided: Bools) -> Bools:
    """Return the pixels (H, W) between which edges count."""
    kept = maps.masked_as(MaskReason.KEPT)
    # Undecided pixels form lines along edges; where there are more of them, it is too dark for edges as well.
    near = cv2.boxFilter(kept.view(np.uint8), cv2.CV_8U, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    usable: Bools = kept | (undecided & maps.masked_as(MaskReason.UNDECIDED) & (near >= _FEWEST_AROUND))
    return usable


def _without_breaks(plan: SequencePlan, maps: CoordinateMap) -> CoordinateMap:
    """Return the map with the discontinuities masked that the refined coordinates reveal."""
    kept = maps.masked_as(MaskReason.KEPT)
    axes = [(number, axis) for number, axis in enumerate(plan.axes) if axis.is_measured]
    broken = np.zeros_like(kept)

    def find(rows: slice) -> None:
        wide, own = widened(rows, 1, len(kept))
        there = kept[wide]
        coordinates = [
            Coordinate(np.where(there, maps.projector_px[wide][..., n], np.nan), maps.variance[wide], maps.reason[wide])
            for n, _ in axes
        ]
        broken[rows] = breaks(there, coordinates, [axis for _, axis in axes], between_edges=True)[own]

    in_slices(len(kept), STRIP_ROWS, find)
    return maps.masked(kept & broken, MaskReason.ISOLATED)


def _levels_of(code_images: CodeImages, code: GrayCode, part: Window) -> StripeLevels:
    """Return the grey levels of a code's bits in a part of the image."""
    thresholds = code_images.thresholds(part) if code.unpaired else {}
    return StripeLevels.of(code, *code_images.frames.stacked(part, code.frames), thresholds)


def _in_projector_px(code: GrayCode, value: Floats32, variance: Floats32) -> None:
    """Convert coordinates (H, W) of a code, in cells from its first, and their variance, in place."""
    value *= np.float32(code.cell)
    value -= np.float32(code.offset + 0.5)
    variance *= np.float32(code.cell**2)


def _apart(value: Floats32, cell: float) -> float:
    """Return how far a cell's centre may be from the values (H, W) around it, in projector pixels;
    negative: not used.
    """
    slopes = [np.nanmedian(np.abs(np.diff(lines_of(image), axis=1))) for image in (value, value.T)]
    # Half a cell from its edge, and the distance of a diagonal neighbour.
    apart = 1 / 2 + sqrt(2) * CELLS_PER_PIXEL
    return apart * cell if cell < _LONG_PX * float(np.hypot(*slopes)) else -1.0


@compiled
def _fill_in_cells(
    by_cells: tuple[Floats32, Floats32, Reasons],
    spread: Floats32,
    axes: Ints,
    apart: Floats32,
    usable: Bools,
    by_edges: tuple[Floats32, Floats32, Reasons],
) -> None:
    """Fill in the centres of cells where no coordinate is known between edges, and the mean of the variances.

    `by_cells` and `by_edges`: coordinates (H, W, 2), variances and reasons; between edges the `axes` (A,) have the
    variances `spread` (A, H, W), which are infinite where unknown. A cell's centre must be within `apart` (A,) of the
    coordinates around it.
    """
    cells_px, cell_variance, reason_of_cell = by_cells
    projector_px, variance, reason = by_edges
    count, height, width = spread.shape
    for row in range(height):
        for column in range(width):
            known = 0
            for k in range(count):
                known += np.isfinite(spread[k, row, column])
            if not usable[row, column] or (known < count and reason_of_cell[row, column] == _UNDECIDED):
                continue
            own, mean, lone = cell_variance[row, column], np.float32(0), False
            for k in range(count):
                if np.isfinite(spread[k, row, column]):
                    mean += spread[k, row, column]
                    continue
                mean += own
                near = _around(projector_px[:, :, axes[k]], spread[k], row, column)
                centre = cells_px[row, column, axes[k]]
                projector_px[row, column, axes[k]] = centre
                lone |= not abs(centre - near) <= apart[k]
            variance[row, column] = mean / np.float32(count)
            reason[row, column] = _ISOLATED if lone else _KEPT
    # Only now, as what is known along one axis tells of the cells around.
    for row in range(height):
        for column in range(width):
            if not usable[row, column] or reason[row, column] == _UNDECIDED:
                for k in range(count):
                    projector_px[row, column, axes[k]] = cells_px[row, column, axes[k]]


@compiled
def _around(value: Floats32, spread: Floats32, row: int, column: int) -> float:
    """Return the mean of the known values in the 3 × 3 neighbourhood of a pixel; NaN if there are none."""
    height, width = value.shape
    total, count = 0.0, 0
    for i in range(max(row - 1, 0), min(row + 2, height)):
        for j in range(max(column - 1, 0), min(column + 2, width)):
            if np.isfinite(spread[i, j]):
                total += value[i, j]
                count += 1
    return total / count if count else np.nan
