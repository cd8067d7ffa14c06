"""Check that neighbouring coordinates are as smooth as their codes or noise allow.

With codes alone, a surface becomes a staircase with the steps of a cell, whose residuals from a smooth surface are the
cell's length over √12. Finest bits that do not belong to the others, because something moved or frames were duplicated
or exchanged, more than double this roughness, whether or not the camera resolves single cells.

Fringes and stripe edges have a sigma from noise. If the residuals are larger, for example from lossy image compression,
the sigma is raised to match them.
"""

import numpy as np

from calib.numerics import Floats, Ints, evenly_spread
from scanner.decoding.axis_decoder import largest_variance
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.sequence_plan import AxisPlan, SequencePlan
from scanner.decoding.significance import HALF
from scanner.errors import InputError

# Size of tiles, with 24 pixels per coefficient of a quadratic surface; candidates along each side of the image; the
# fewest and the most for a median ratio.
_TILE_PX, _GRID, _FEWEST_TILES, _MOST_TILES = 12, 64, 20, 100
# Largest residual variance, relative to that of a cell: 1 for a staircase, less where pixels average over cells, up to
# 3 where a nonlinear camera without inverse patterns narrows every second stripe; 5 and more for wrong bits.
_MOST = 4.0
# Relative to the noise variance; texture, edges and creases leave a median slightly above 1.
_MOST_OF_FRINGES = 2.0


def check_roughness(plan: SequencePlan, maps: Maps) -> None:
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


def widen_by_roughness(plan: SequencePlan, maps: Maps) -> None:
    """Raise the variance of fringe coordinates, in place, to the scatter of neighbours; mask pixels too noisy then as
    dark.
    """
    if not plan.fringes or plan.only_axis is not None:
        return
    relative = float(np.mean(_roughness(maps)))
    if relative < _MOST_OF_FRINGES:
        return
    np.multiply(maps.variance, np.float32(relative), out=maps.variance)
    just_seen = [largest_variance(axis.fringes[0], with_gray=bool(axis.codes)) for axis in plan.axes if axis.fringes]
    dark = (maps.reason == np.uint8(MaskReason.KEPT)) & (maps.variance > np.float32(np.mean(just_seen)))
    maps.reason[dark] = np.uint8(MaskReason.DARK)
    maps.projector_px[dark] = np.nan


def widen_between_edges(plan: SequencePlan, maps: Maps) -> None:
    """Raise the variance of coordinates between stripe edges to the scatter of neighbours, in place.

    The unknown shape of edges, due to the lens or camera software, exceeds the noise in good light.
    """
    if plan.only_axis is None:
        relative = max(1.0, float(np.mean(_roughness(maps))))
        np.multiply(maps.variance, np.float32(relative), out=maps.variance)


def _roughness(maps: Maps) -> tuple[float, float]:
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


def _in_tiles(maps: Maps) -> Ints:
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
