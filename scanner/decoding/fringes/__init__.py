"""Fringes: phase unwrapping, systematic phase errors, and contradictions between codes that fringes resolve."""

from scanner.decoding.fringes.footprint import (
    CROSS,
    MOST_BEND_PX,
    REACH_PX,
    TYPICAL_PX2,
    Footprint,
    correct_curvature_shift,
    correct_shading_shift,
    footprint_of,
    log_amplitude,
    shading_shift,
    surrounded,
)
from scanner.decoding.fringes.phase_unwrapping import (
    Orders,
    Tolerances,
    Wrapped,
    disagreements,
    in_nearest_cycle,
    measured_tolerances,
    resolve_contradictory_codes,
    unwrap,
    widest_tolerances,
)
from scanner.decoding.fringes.single_fringe import FringeSample, Unchecked, can_ripple, response_of, straightening
from scanner.decoding.fringes.systematic_error import BLOCK_PX, correct_systematic
