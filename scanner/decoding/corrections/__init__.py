"""Effects on whole frames, measured and removed before decoding: gains, ghosts, the camera's response, late frames."""

from scanner.decoding.corrections.corrected_frames import CorrectedFrames, FrameCorrections
from scanner.decoding.corrections.gains import as_in_patterns, extreme, fit_bits, gains_of_pairs, white_and_threshold
