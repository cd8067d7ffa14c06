"""Detection and correction of motion during a capture: of the camera, the projector or objects in the scene."""

from scanner.decoding.motion.between_axes import halves_of, motion_between
from scanner.decoding.motion.code_shift import CodeShift, shifts_of_codes
from scanner.decoding.motion.device_motion import (
    LEAST_PX,
    UNSEEN_MOTION,
    MotionEstimate,
    attribute_to_motion,
    attribute_to_shifts,
    motion_findings,
    moved,
    refuse_period_slips,
    refuse_unexplained_motion,
)
from scanner.decoding.motion.inconsistent_pixels import InconsistentPixels, find_inconsistent_pixels
from scanner.decoding.motion.measure import measure_motion
from scanner.decoding.motion.pixels import ObservedFringes
from scanner.decoding.motion.rigid_motion import (
    CoordinateShift,
    RigidFit,
    fit_motion,
    moved_device,
    shifts_by_motion,
    turns_px,
)
from scanner.decoding.motion.scene_motion import SUSPECTED_PX
from scanner.decoding.motion.single_frames import find_phase_jump
from scanner.decoding.motion.wrong_bits import mask_wrong_bits, repair_codes
