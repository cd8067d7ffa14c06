"""The coordinates of all pixels, without those that the capture itself proves wrong."""

import numpy as np

from scanner.decoding.accumulators import Accumulators
from scanner.decoding.checks.cycle_checks import check_cycles
from scanner.decoding.checks.roughness import check_roughness, widen_by_roughness
from scanner.decoding.checks.stray_light import leave_out_stray_light
from scanner.decoding.coordinate_maps import Maps, coordinate_maps
from scanner.decoding.edge_refinement import refine_by_edges
from scanner.decoding.learning import Learnt, Seen
from scanner.decoding.mask_reasons import MaskReason
from scanner.decoding.motion import blaming_shifts, mask_wrong_bits


def checked_maps(accumulators: Accumulators, learnt: Learnt, seen: Seen, *, is_anomalous: bool) -> tuple[Maps, bool]:
    """The maps, and whether each pixel has a coordinate of its own, of fringes or between edges, or that of its cell.

    `is_anomalous`: whether the frames have an anomaly. Raises InputError if neighbours contradict each
    other all over the picture, RefusalError if something moved between codes and fringes.
    """
    plan = accumulators.plan
    maps = coordinate_maps(accumulators, learnt.decoders, seen.moved, seen.corrupted)
    if seen.moved is not None and not seen.code_shifts:
        mask_wrong_bits(plan, maps, seen.moved)
    elif is_anomalous and not plan.fringes:
        # Before stripes tell coordinates between their edges, of which those of wrong bits are as smooth as others.
        mask_wrong_bits(plan, maps, None)
    undecided = maps.reason == np.uint8(MaskReason.UNDECIDED)
    leave_out_stray_light(accumulators, maps)
    check_roughness(plan, maps)
    widen_by_roughness(plan, maps)
    refined = refine_by_edges(accumulators, maps, seen.noise, undecided)
    with blaming_shifts(plan, seen.code_shifts):
        check_cycles(plan, maps.projector_px)
    if is_anomalous and seen.moved is None and plan.fringes:
        mask_wrong_bits(plan, maps, None)
    return maps, refined or bool(plan.fringes)
