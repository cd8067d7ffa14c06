"""Pixels that have a code by stray light: what has come by way of other surfaces, or from inside of them, is dim.

Where a scene is dark, such light still has bits, some of them wrong. How dim is too dim depends on scene, camera and
noise; but wrong codes break the epipolar geometry of the others, and show from which contrast on they do not. The same
is asked of pixels that did without some bits, be it because they see two cells, or because their light is stray.
Fringes need no such check: their amplitude is that of direct light.
"""

import numpy as np

from calib.geometry import Matches
from calib.numerics import Bools, Floats, Image
from scanner.decoding.accumulators import Accumulators
from scanner.decoding.arrays import Floats32
from scanner.decoding.checks.consequences import EPIPOLAR_PX, epipolar_matrix, from_epipolar_lines
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.mask_reasons import MaskReason

_FEWEST = 1000
_MOST_FOR_MATRIX, _MOST_COMPARED = 4000, 20_000
# Pixels are looked at in so many steps of contrast, from the brightest on, until as many more are off as here.
_STEPS = 20
_MOST_OFF = 0.25
_SEED = 6


def leave_out_stray_light(accumulators: Accumulators, maps: Maps) -> None:
    """Mask pixels without fringes that are too dim for their codes to be right, in place; all that are as dim."""
    plan = accumulators.plan
    contrasts = [fold.contrast for fold in accumulators.codes if fold.contrast is not None]
    if plan.fringes or plan.only_axis is not None or not contrasts:
        return
    contrast: Image = np.min(contrasts, axis=0)
    kept = maps.reason == np.uint8(MaskReason.KEPT)
    # Pixels that have all their bits have the variance of a cell.
    partial = kept & (maps.variance > np.float32(1.01 * sum(axis.cell**2 for axis in plan.axes) / 24))
    whole = kept & ~partial
    if np.count_nonzero(whole) < _FEWEST:
        return
    # Of all, for the brightest may lie in a plane, which has no epipolar geometry of its own.
    matrix = epipolar_matrix(_matches(_some(whole, _MOST_FOR_MATRIX), maps))
    if matrix is None:
        return
    usual = 0.0
    for group in (whole, partial):
        row, column = places = _some(group, _MOST_COMPARED)
        if len(row) < _FEWEST:
            continue
        off = from_epipolar_lines(_matches(places, maps), matrix) > EPIPOLAR_PX
        levels = contrast[row, column].astype(np.float32)
        if group is whole:
            usual = float(np.mean(off[levels >= np.median(levels)]))
        faintest = _faintest(levels, off, usual)
        np.copyto(maps.reason, np.uint8(MaskReason.UNDECIDED), where=group & (contrast < faintest))


def _faintest(contrast: Floats32, off: Bools, usual: float) -> float:
    """From which contrast on pixels (P,) are not `off` more often than usual; above all of them if none are."""
    order = np.argsort(-contrast, kind="stable")
    faintest = float(np.inf)
    for step in np.array_split(order, _STEPS):
        if np.mean(off[step]) > usual + _MOST_OFF:
            return faintest
        faintest = float(contrast[step].min())
    return 0.0


def _some(chosen: Bools, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of some of the chosen pixels (H, W)."""
    places = np.flatnonzero(chosen)
    if len(places) > most:
        places = np.random.default_rng(_SEED).choice(places, most, replace=False)
    row, column = np.divmod(places, chosen.shape[1])
    return row, column


def _matches(places: tuple[np.ndarray, np.ndarray], maps: Maps) -> Matches:
    row, column = places
    camera_px: Floats = np.stack([column, row], axis=1).astype(np.float64)
    return Matches(camera_px, maps.projector_px[row, column].astype(np.float64))
