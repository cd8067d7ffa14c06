"""Collect the matches of the kept pixels, and the reasons why the others are masked."""

from concurrent.futures import ThreadPoolExecutor
from typing import cast

import numpy as np
from numpy.typing import NDArray

from calib.geometry import Matches
from calib.numerics import Bools, Floats, Floats32, Image, compiled
from scanner.decoding.axis_decoder import mask_outside
from scanner.decoding.checks.map_checks import check_maps
from scanner.decoding.codes.code_cells import average_cells
from scanner.decoding.coordinate_maps import Maps
from scanner.decoding.discontinuities import small_patches
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.one_axis import OneAxis
from scanner.decoding.sequence_plan import SequencePlan


def match_kept(
    plan: SequencePlan, maps: Maps, white: Image, one_axis: OneAxis | None, cell_px: Floats32 | None
) -> tuple[Matches, NDArray[np.uint8]]:
    """Return the matches, and for all pixels (H, W) the mask reason. Raises InputError; overwrites the maps.

    `white`: (H, W) grey. `cell_px`: (H, W, 2) the centre of each pixel's cell, for one match per cell of the codes;
    None if each pixel has its own coordinate.
    """
    reasons = maps.reason
    # Interpolation between blurred edges, or a motion that was taken back, may carry coordinates beyond the border.
    for number, axis in enumerate(plan.axes):
        mask_outside(axis, maps.projector_px.reshape(-1, 2)[:, number], reasons.reshape(-1))
    if one_axis:
        # Before the calibration masks pixels, which would be its error rather than the frames'.
        check_maps(plan, maps, reasons == np.uint8(MaskReason.KEPT))
        one_axis.complete(maps)
    kept = reasons == np.uint8(MaskReason.KEPT)
    if cell_px is None:
        np.copyto(reasons, np.uint8(MaskReason.ISOLATED), where=small_patches(kept))
    else:
        if one_axis:
            cells = one_axis.average_stripes(kept, maps, white)
        else:
            cells = average_cells(kept, cell_px, maps.projector_px, maps.variance, white)
        np.copyto(reasons, np.uint8(MaskReason.ISOLATED), where=cells.rejected)
    kept = reasons == np.uint8(MaskReason.KEPT)
    if not one_axis:
        check_maps(plan, maps, kept)
    if cell_px is None:
        return _pixel_matches(kept, maps), reasons
    return Matches(cells.camera_px, cells.projector_px, sigma_px=np.sqrt(cells.variance)), reasons


def _pixel_matches(kept: Bools, maps: Maps) -> Matches:
    """Return the matches of `kept` pixels (H, W), row by row, in the memory of the maps.

    Single precision is exact for camera pixels, and is the precision of the maps.
    """
    count = int(np.count_nonzero(kept))
    camera_px, projector_px = np.empty((count, 2), np.float32), maps.projector_px.reshape(-1, 2)
    sigma_px = maps.variance.reshape(-1)
    with ThreadPoolExecutor(1) as aside:
        noted = aside.submit(_note_places, kept, camera_px)
        _gather(kept.reshape(-1), projector_px, sigma_px)
        noted.result()
    return Matches(cast(Floats, camera_px), cast(Floats, projector_px[:count]), sigma_px=cast(Floats, sigma_px[:count]))


@compiled
def _note_places(kept: Bools, camera_px: Floats32) -> None:
    """Write the columns and rows of the kept pixels."""
    height, width = kept.shape
    match = 0
    for row in range(height):
        for column in range(width):
            if kept[row, column]:
                camera_px[match, 0], camera_px[match, 1] = column, row
                match += 1


@compiled
def _gather(kept: Bools, projector_px: Floats32, variance: Floats32) -> None:
    """Move the data of the kept pixels (P, …) to the front, with the variance replaced by its square root."""
    match = 0
    for pixel in range(len(kept)):
        if kept[pixel]:
            projector_px[match, 0], projector_px[match, 1] = projector_px[pixel, 0], projector_px[pixel, 1]
            variance[match] = np.sqrt(variance[pixel])
            match += 1
