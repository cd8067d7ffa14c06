"""Scans from a recording that nothing synchronised: the video to show, and a capture from a film of it."""

from scanner.recordings.clocks import exposure_text
from scanner.recordings.import_recording import Imported, import_recording
from scanner.recordings.programme import CONTAINERS, Programme, programme_of, read_programme, write_player_video
