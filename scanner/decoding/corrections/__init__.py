"""Effects on whole frames, measured and removed before decoding: gains, ghosts, the camera's response, late frames."""

from scanner.decoding.corrections.corrected_frames import CorrectedFrames, FrameCorrections
from scanner.decoding.corrections.gains import (
    BitLevels,
    FrameGains,
    as_in_patterns,
    extreme,
    fit_bits,
    white_and_threshold,
)
