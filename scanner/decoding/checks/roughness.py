"""Cells of a code that do not follow each other: bits that were shown before something moved, or twice, or exchanged.

Where only codes tell a coordinate, a surface is a staircase, whose steps are as long as a cell: pixels are off what is
smooth by the cell's length over √12, be it flat or in relief. Finest bits that do not belong to the others leave a
jumble that is more than twice as rough, whatever each bit by itself looks like, and whether or not the camera resolves
the single cells.

Fringes, and edges of stripes, have a sigma by noise. Where neighbours are farther off what is smooth, as by what a file
format leaves out, the sigma is what they are off.
"""

import numpy as np

from calib.numerics import Floats, Ints
from scanner.decoding.axis_decoder import largest_variance
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.errors import InputError

_TILE_PX = 12
_MOST_ALONG, _MOST_ALONG_FRINGES = 32, 10
# So many along each side of the image are looked through for them.
_GRID = 64
_FEWEST_KNOWN = 0.6
_FEWEST_TILES = 20
# Variance off what is smooth, in those of a cell: 1 for a staircase, less where pixels average over cells, up to 3
# where a bent camera curve and no inverse make every second stripe narrow; 5 and more for a jumble.
_MOST = 4.0
_SUSPECTED_BITS = 3
# In variances by noise; texture, edges and creases leave somewhat more than 1 in the median.
_MOST_OF_FRINGES = 2.0


def check_roughness(plan: SequencePlan, maps: Maps) -> None:
    """Raise InputError if coordinates by codes alone are much rougher than their cells."""
    if plan.fringes or plan.only_axis is not None:
        return
    for axis, relative in zip(plan.axes, _roughness(maps, _MOST_ALONG), strict=True):
        if relative > _MOST:
            raise InputError(
                f"along {axis.axis} the cells of the Gray code do not follow each other: they are {axis.cell:g} px "
                f"long, but pixels next to each other jump to and fro by {np.sqrt(relative / 12) * axis.cell:.1f} px. "
                f"Did something move in between, or were frames exchanged or repeated? {plan.names(_finest(axis))}"
            )


def widen_by_roughness(plan: SequencePlan, maps: Maps) -> None:
    """Raise the variance of coordinates by fringes, in place, if neighbours differ by more; mask what is dark then."""
    if not plan.fringes or plan.only_axis is not None:
        return
    relative = float(np.mean(_roughness(maps, _MOST_ALONG_FRINGES)))
    if relative < _MOST_OF_FRINGES:
        return
    np.multiply(maps.variance, np.float32(relative), out=maps.variance)
    just_seen = [largest_variance(axis.fringes[0], with_gray=bool(axis.codes)) for axis in plan.axes if axis.fringes]
    dark = (maps.reason == np.uint8(MaskReason.KEPT)) & (maps.variance > np.float32(np.mean(just_seen)))
    maps.reason[dark] = np.uint8(MaskReason.DARK)
    maps.projector_px[dark] = np.nan


def widen_between_edges(plan: SequencePlan, maps: Maps) -> None:
    """Raise the variance of coordinates between edges of stripes to what neighbours are off what is smooth, in place.

    How a lens, or a camera's software, shapes an edge is not known, and is more than noise in a good light.
    """
    if plan.only_axis is None:
        relative = max(1.0, float(np.mean(_roughness(maps, _MOST_ALONG))))
        np.multiply(maps.variance, np.float32(relative), out=maps.variance)


def _roughness(maps: Maps, most_along: int) -> tuple[float, float]:
    """Of x and y, the variance off smooth surfaces through small tiles, over the stated one; the median, 0 if few."""
    pixels = _in_tiles(maps, most_along)
    seen = maps.projector_px.reshape(-1, 2)[pixels].astype(np.float64)
    variance = maps.variance.reshape(-1)[pixels]
    known = np.isfinite(seen).all(axis=2) & (maps.reason.reshape(-1)[pixels] == 0)
    enough = known.mean(axis=1) > _FEWEST_KNOWN
    if np.count_nonzero(enough) < _FEWEST_TILES:
        return 0.0, 0.0
    seen, variance, known = seen[enough], variance[enough], known[enough]
    square = _off_smooth(np.where(known[..., None], seen, 0.0), known)
    cells = np.sum(np.where(known, variance, 0), axis=1)
    x, y = np.median(square / cells[:, None], axis=0)
    return float(x), float(y)


def _in_tiles(maps: Maps, most_along: int) -> Ints:
    """The pixels (T, P) of some tiles in which most are kept, however little of the image that is."""
    height, width = maps.reason.shape
    rows, columns = (np.linspace(0, n - _TILE_PX, min(_GRID, n // _TILE_PX)).astype(np.int64) for n in (height, width))
    corners = (rows[:, None] * width + columns).reshape(-1)
    within = (np.arange(_TILE_PX)[:, None] * width + np.arange(_TILE_PX)).reshape(-1)
    kept = maps.reason.reshape(-1)[corners[:, None] + within] == np.uint8(MaskReason.KEPT)
    corners = corners[kept.mean(axis=1) > _FEWEST_KNOWN]
    chosen = corners[np.linspace(0, len(corners) - 1, min(len(corners), most_along**2)).astype(np.int64)]
    pixels: Ints = chosen[:, None] + within
    return pixels


def _off_smooth(seen: Floats, known: np.ndarray) -> Floats:
    """Sums of squares (T, 2) of what smooth surfaces, polynomials of second degree, through tiles leave of the `known`
    (T, P) coordinates (T, P, 2).
    """
    v, u = np.mgrid[:_TILE_PX, :_TILE_PX] - (_TILE_PX - 1) / 2
    u, v = u.ravel() / _TILE_PX, v.ravel() / _TILE_PX
    terms = np.stack([np.ones(u.size), u, v, u * u, u * v, v * v], axis=1)
    weighted = terms.T * known[:, None, :]
    surfaces = np.linalg.solve(weighted @ terms, weighted @ seen)
    left = (seen - terms @ surfaces) * known[..., None]
    squares: Floats = np.sum(left**2, axis=1)
    return squares


def _finest(axis: AxisPlan) -> list[int]:
    """The frames of the finest bits of an axis."""
    code = min(axis.codes, key=lambda code: code.cell)
    last = range(code.bits - _SUSPECTED_BITS, code.bits)
    return [frames[bit] for bit in last for frames in (code.normal, code.inverse) if bit in frames]
