"""Motion during a capture: of the camera, of the projector, of something in the scene."""

from scanner.decoding.motion.blame import blaming, moved, remarks_on
from scanner.decoding.motion.code_shift import shifts_of_codes
from scanner.decoding.motion.found import SUSPECTED_PX, MotionFound
from scanner.decoding.motion.measure import measure_motion
from scanner.decoding.motion.tile_sample import TileSample

__all__ = [
    "SUSPECTED_PX",
    "MotionFound",
    "TileSample",
    "blaming",
    "measure_motion",
    "moved",
    "remarks_on",
    "shifts_of_codes",
]
