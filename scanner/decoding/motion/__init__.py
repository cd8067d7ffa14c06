"""Detection and correction of motion during a capture: of the camera, the projector or objects in the scene."""

from scanner.decoding.motion.code_shift import CodeShift, shifts_of_codes
from scanner.decoding.motion.device_motion import (
    LEAST_PX,
    SUSPECTED_PX,
    CoordinateShift,
    MotionEstimate,
    moved_device,
    turns_px,
)
from scanner.decoding.motion.inconsistent_pixels import InconsistentPixels, find_inconsistent_pixels
from scanner.decoding.motion.measure import measure_motion
from scanner.decoding.motion.phase_jump import find_phase_jump
from scanner.decoding.motion.pixels import MOST_ROUGH_PX, ObservedFringes
from scanner.decoding.motion.refusals import (
    UNSEEN_MOTION,
    attribute_to_motion,
    attribute_to_shifts,
    motion_findings,
    moved,
    refuse_period_slips,
    refuse_unexplained_motion,
)
from scanner.decoding.motion.rigid import COLUMNS, PER_DEVICE, RigidFit, fit_motion, shifts_by_motion
from scanner.decoding.motion.wrong_bits import mask_wrong_bits
