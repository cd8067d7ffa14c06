"""Decode structured-light sequences: sequence plan, folding of frames, fringe orders, masks, checks."""

from calib.numerics import Floats32
from scanner.decoding.coordinates.coordinate_map import CoordinateMap
from scanner.decoding.corrections.corrected_frames import FrameCorrections, estimate_corrections
from scanner.decoding.decoder import Decoder, Decoding
from scanner.decoding.frame_stack import FrameCollector, describe_copies, require_decoding_memory
from scanner.decoding.fringes.phase_unwrapping import in_nearest_cycle
from scanner.decoding.fringes.single_fringe import UNCHECKED
from scanner.decoding.fringes.systematic_error import SMOOTH_PX, smooth_error_px
from scanner.decoding.image_quality import MUCH_FLICKER, TOO_DARK, FinestStripes, first_harmonics
from scanner.decoding.light.exposures import saturation_level
from scanner.decoding.light.samples import TILE_PX, GridSample, Samples, TileSample
from scanner.decoding.map_checks import MirroredError
from scanner.decoding.mask_reasons import MaskReason, PixelFlags
from scanner.decoding.matches import ONE_AXIS
from scanner.decoding.motion import SUSPECTED_PX, UNSEEN_MOTION, MotionVerdict, moved
from scanner.decoding.planning import plan_sequence, usable
from scanner.decoding.sequence_plan import AxisPlan, Fringe, SequencePlan
