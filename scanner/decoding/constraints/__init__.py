"""What the frames of a sequence must satisfy: sums and extremes of light, cosines, steady ambient light."""

from scanner.decoding.constraints.ambient_light_change import AmbientLightChange, without_change
from scanner.decoding.constraints.frame_consistency import (
    FRAMES_CONTRADICT,
    LEFT_BY_SWAP,
    MOST_BROKEN,
    anomaly,
    suspected,
)
from scanner.decoding.constraints.photometric_constraints import STATIC_SHARE, find_violations, frames_of_fine_bits
