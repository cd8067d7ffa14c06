"""Masking of pixels whose code comes from stray light: interreflection or subsurface scattering, which is dim.

In dark parts of a scene, such light still has bits, some of them wrong. The threshold depends on scene, camera and
noise. It is found from the epipolar geometry of the other pixels, which wrong codes violate. Pixels that were decoded
without some of their bits are tested in the same way. Fringes need no such check: their amplitude is that of direct
light.
"""

import numpy as np

from calib.geometry import Matches
from calib.numerics import Bools, Floats, Floats32, Image, at_random
from scanner.decoding.checks.consequences import EPIPOLAR_PX, epipolar_matrix, from_epipolar_lines
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.folded_frames import FoldedFrames
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.significance import FEWEST_PIXELS

# Pixels are tested in this many steps of contrast, brightest first, until the share of outliers rises by this much.
_STEPS, _MOST_OUTLIERS = 20, 0.25
_FEWEST = _STEPS * FEWEST_PIXELS


def leave_out_stray_light(folded: FoldedFrames, maps: Maps) -> None:
    """Mask, in place, pixels without fringes whose contrast is too low for reliable codes."""
    plan = folded.plan
    contrasts = [fold.contrast for fold in folded.codes if fold.contrast is not None]
    if plan.fringes or plan.only_axis is not None or not contrasts:
        return
    contrast: Image = np.min(contrasts, axis=0)
    kept = maps.reason == np.uint8(MaskReason.KEPT)
    # Pixels with all their bits have the variance of a cell.
    partial = kept & (maps.variance > np.float32(1.01 * sum(axis.cell**2 for axis in plan.axes) / 24))
    whole = kept & ~partial
    if np.count_nonzero(whole) < _FEWEST:
        return
    # From all pixels: the brightest may lie in a plane, which leaves the geometry undetermined.
    matrix = epipolar_matrix(_matches(_some(whole), maps))
    if matrix is None:
        return
    usual = 0.0
    for group in (whole, partial):
        row, column = places = _some(group)
        if len(row) < _FEWEST:
            continue
        is_outlier = from_epipolar_lines(_matches(places, maps), matrix) > EPIPOLAR_PX
        levels = contrast[row, column].astype(np.float32)
        if group is whole:
            usual = float(np.mean(is_outlier[levels >= np.median(levels)]))
        faintest = _faintest(levels, is_outlier, usual)
        np.copyto(maps.reason, np.uint8(MaskReason.UNDECIDED), where=group & (contrast < faintest))


def _faintest(contrast: Floats32, is_outlier: Bools, usual: float) -> float:
    """Return the lowest contrast down to which `is_outlier` (P,) is no more frequent than usual; ∞ if there is none."""
    order = np.argsort(-contrast, kind="stable")
    faintest = float(np.inf)
    for step in np.array_split(order, _STEPS):
        if np.mean(is_outlier[step]) > usual + _MOST_OUTLIERS:
            return faintest
        faintest = float(contrast[step].min())
    return 0.0


def _some(chosen: Bools) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of some of the chosen pixels (H, W)."""
    places = np.flatnonzero(chosen)
    row, column = np.divmod(places[at_random(len(places))], chosen.shape[1])
    return row, column


def _matches(places: tuple[np.ndarray, np.ndarray], maps: Maps) -> Matches:
    row, column = places
    camera_px: Floats = np.stack([column, row], axis=1).astype(np.float64)
    return Matches(camera_px, maps.projector_px[row, column].astype(np.float64))
