"""Detection and correction of motion during a capture: of the camera, the projector or objects in the scene."""

from scanner.decoding.motion.between_axes import halves_of, motion_between
from scanner.decoding.motion.fringe_motion import measure_motion
from scanner.decoding.motion.fringe_pixels import ObservedFringes
from scanner.decoding.motion.inconsistent_pixels import InconsistentPixels, find_inconsistent_pixels
from scanner.decoding.motion.motion_estimate import (
    SUSPECTED_PX,
    UNSEEN_MOTION,
    CodeShift,
    DetectedMotion,
    MotionCourse,
    MotionEstimate,
    MotionVerdict,
    attribute_to_motion,
    attribute_to_shifts,
    between_periods_px,
    motion_findings,
    moved,
    refuse_period_slips,
    refuse_unexplained_motion,
)
from scanner.decoding.motion.phase_jumps import find_phase_jump, shifts_of_codes
from scanner.decoding.motion.rigid_motion import CoordinateShift, RigidFit, fit_motion, moved_device, shifts_by_motion
from scanner.decoding.motion.wrong_bits import mask_wrong_bits, repair_codes
