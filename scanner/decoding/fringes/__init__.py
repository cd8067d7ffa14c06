"""Fringes: phase unwrapping, systematic phase errors, and contradictions between codes that fringes resolve."""

from scanner.decoding.fringes.footprint_shift import Footprint, shading_shift
from scanner.decoding.fringes.phase_unwrapping import disagreements
from scanner.decoding.fringes.single_fringe import is_unchecked
