"""The stream of (pattern, frame), whether live, recorded or simulated, and its recording on disk."""

from scanner.capture.capture_metadata import SMOOTH_KEY, CaptureMetadata, identity, with_smooth_errors_of_film
from scanner.capture.recorder import CAPTURE_FILE, record
from scanner.capture.recording import Recording, capture_above, open_capture
from scanner.capture.resuming import take_up
from scanner.capture.rig_placement import check_places, next_place
from scanner.capture.single_pixels import (
    CHANGED_SHAPE,
    findings_on_lines,
    known_of_lines,
    lines_of_light,
    measure_lines,
    shows_single_pixels,
)
from scanner.capture.steady_camera import findings_on_camera
from scanner.capture.stream import Stream, capture, capture_together, refuse_another_size
