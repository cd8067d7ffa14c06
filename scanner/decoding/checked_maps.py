"""Compute the coordinates of all pixels, and mask those that the capture itself proves wrong."""

import numpy as np

from calib.numerics import Bools
from scanner.decoding.checks.epipolar_test import leave_out_stray_light
from scanner.decoding.checks.map_checks import check_cycles
from scanner.decoding.checks.roughness import check_roughness, widen_by_roughness
from scanner.decoding.code_images import CodeImages
from scanner.decoding.coordinate_maps import Maps, coordinate_maps
from scanner.decoding.edge_refinement import refine_by_edges
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.motion import attribute_to_shifts, mask_wrong_bits
from scanner.decoding.motion.bit_repair import repair_bits
from scanner.decoding.motion.inconsistent_pixels import InconsistentPixels
from scanner.decoding.sample_analysis import CalibratedDecoders, Observations


def checked_maps(
    code_images: CodeImages,
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
    plan = code_images.plan
    inconsistent = observed.inconsistent
    corrupted = None if inconsistent is None else inconsistent.corrupted & ~_repaired(code_images, inconsistent)
    maps = coordinate_maps(code_images, calibrated.decoders, observed.moved, corrupted)
    if observed.moved is not None and not observed.code_shifts:
        mask_wrong_bits(plan, maps, observed.moved)
    elif is_anomalous and not plan.fringes:
        # Before interpolation between stripe edges, which makes coordinates smooth even where a bit is wrong.
        mask_wrong_bits(plan, maps, None)
    undecided = maps.reason == np.uint8(MaskReason.UNDECIDED)
    leave_out_stray_light(code_images, maps)
    check_roughness(plan, maps)
    widen_by_roughness(plan, maps)
    refined = refine_by_edges(code_images, maps, observed.noise, undecided)
    with attribute_to_shifts(plan, observed.code_shifts):
        check_cycles(plan, maps.projector_px)
    if is_anomalous and observed.moved is None and plan.fringes:
        mask_wrong_bits(plan, maps, None)
    return maps, refined or bool(plan.fringes)


def _repaired(code_images: CodeImages, inconsistent: InconsistentPixels) -> Bools:
    """Decide corrupted bits of plain Gray codes, in place; return the pixels (H, W) at which all of them are
    decided.
    """
    unrepaired, decided = (np.zeros(code_images.white.shape, np.bool_) for _ in range(2))
    for code_words in code_images.codes:
        by_bit = {
            bit: inconsistent.corrupted_by_frames[pair]
            for bit, pair in code_words.code.pairs.items()
            if pair in inconsistent.corrupted_by_frames
        }
        if by_bit and code_words.code.base is None:
            frames = dict(code_images.equalised(frames=code_words.code.frames))
            repaired = repair_bits(code_words, by_bit, frames, inconsistent.static)
            unrepaired |= np.logical_or.reduce(list(by_bit.values())) & ~repaired
            decided |= repaired
    return decided & ~unrepaired
