"""Effects on whole frames, measured and removed before decoding: gains, ghosts, the camera's response, late frames."""

from scanner.decoding.corrections.corrected_frames import CorrectedFrames, FrameCorrections
from scanner.decoding.corrections.gains import gains_of_pairs, levels_of_bit, white_of
