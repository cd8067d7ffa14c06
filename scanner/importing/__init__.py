"""Recordings of other programs → capture folders: the order of the frames, and the projector."""

from scanner.importing.capture_folder import write_capture
from scanner.importing.frame_files import FrameFiles, find_frames
from scanner.importing.fringe_layouts import fringe_layouts
from scanner.importing.layout import FrameLayout, Given
from scanner.importing.layouts import LAYOUTS
from scanner.importing.order_description import describe_order
from scanner.importing.plausibility import OrderStage
from scanner.importing.projector_size import DIAMOND_ARRAYS
from scanner.importing.recognition import Recognised, Rejected, recognise
from scanner.importing.samples import LevelSamples, take_samples
