"""Recordings of other programs → capture folders: the order of the frames, and the projector."""

from scanner.importing.capture_folder import write_capture
from scanner.importing.frame_files import FrameFiles, find_frames
from scanner.importing.layout import FrameLayout, Given
from scanner.importing.layouts import LAYOUTS
from scanner.importing.orders import fringe_layouts
from scanner.importing.plausibility import OrderStage
from scanner.importing.projector_size import DIAMOND_ARRAYS, describe_order
from scanner.importing.recognition import Recognised, Rejected, recognise
from scanner.importing.samples import LevelSamples, take_samples
