"""The stream of (pattern, frame), whether live, recorded or simulated, and its recording on disk."""

from scanner.capture.facts import CaptureFacts, identity
from scanner.capture.recording import CAPTURE_FILE, Recording, open_capture, record
from scanner.capture.rig_placement import check_places, next_place
from scanner.capture.stream import Stream, capture
