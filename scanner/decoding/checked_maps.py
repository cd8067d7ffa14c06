"""Compute the coordinates of all pixels, and mask those that the capture itself proves wrong."""

import numpy as np

from calib.numerics import Bools
from scanner.decoding.checks.epipolar_test import leave_out_stray_light
from scanner.decoding.checks.map_checks import check_cycles
from scanner.decoding.checks.roughness import check_roughness, widen_by_roughness
from scanner.decoding.code_images import FoldedFrames
from scanner.decoding.coordinate_maps import Maps, coordinate_maps
from scanner.decoding.edge_refinement import refine_by_edges
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.motion import blaming_shifts, mask_wrong_bits
from scanner.decoding.motion.bit_repair import repair_bits
from scanner.decoding.motion.inconsistent_pixels import InconsistentPixels
from scanner.decoding.sample_analysis import CalibratedDecoders, Observations


def checked_maps(
    folded: FoldedFrames,
    calibrated: CalibratedDecoders,
    observed: Observations,
    *,
    is_anomalous: bool,
) -> tuple[Maps, bool]:
    """Return the maps, and whether each pixel has its own coordinate (from fringes or stripe edges) or that of its
    cell.

    `is_anomalous`: whether the frame checks found an anomaly. Raises InputError if neighbours contradict each other
    all over the image, RefusalError if something moved between codes and fringes.
    """
    plan = folded.plan
    inconsistent = observed.inconsistent
    corrupted = None if inconsistent is None else inconsistent.corrupted & ~_repaired(folded, inconsistent)
    maps = coordinate_maps(folded, calibrated.decoders, observed.moved, corrupted)
    if observed.moved is not None and not observed.code_shifts:
        mask_wrong_bits(plan, maps, observed.moved)
    elif is_anomalous and not plan.fringes:
        # Before interpolation between stripe edges, which makes coordinates smooth even where a bit is wrong.
        mask_wrong_bits(plan, maps, None)
    undecided = maps.reason == np.uint8(MaskReason.UNDECIDED)
    leave_out_stray_light(folded, maps)
    check_roughness(plan, maps)
    widen_by_roughness(plan, maps)
    refined = refine_by_edges(folded, maps, observed.noise, undecided)
    with blaming_shifts(plan, observed.code_shifts):
        check_cycles(plan, maps.projector_px)
    if is_anomalous and observed.moved is None and plan.fringes:
        mask_wrong_bits(plan, maps, None)
    return maps, refined or bool(plan.fringes)


def _repaired(folded: FoldedFrames, inconsistent: InconsistentPixels) -> Bools:
    """Decide spoilt bits of plain Gray codes, in place; return the pixels (H, W) at which all of them are decided."""
    spoilt, decided = (np.zeros(folded.brightest.shape, np.bool_) for _ in range(2))
    for fold in folded.codes:
        by_bit = {
            bit: inconsistent.spoilt[pair] for bit, pair in fold.code.pairs.items() if pair in inconsistent.spoilt
        }
        if by_bit and fold.code.base is None:
            shown = dict(folded.alike(frames=fold.code.frames))
            repaired = repair_bits(fold, by_bit, shown, inconsistent.resting)
            spoilt |= np.logical_or.reduce(list(by_bit.values())) & ~repaired
            decided |= repaired
    return decided & ~spoilt
