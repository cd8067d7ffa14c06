"""Grey levels: samples of the frames, their noise, brightness and exposure, and what the light of all must satisfy."""

from scanner.decoding.light.ambient_light_change import AmbientLightChange, is_suspected
from scanner.decoding.light.brightness import (
    BANDS,
    LEAST_DIFFERENCE,
    PASSES,
    Gains,
    LitRows,
    flicker_of,
    gains_of_fringe,
    gains_of_pair,
    residual_of_gains,
    starts_of_bands,
)
from scanner.decoding.light.constraints import (
    STATIC_SHARE,
    STRAY_PART,
    ConstraintSet,
    LitSample,
    NoiseModel,
    find_violations,
    frames_of_fine_bits,
    measure_noise,
)
from scanner.decoding.light.exposures import LIT, lit_by, saturation_level, unclipped
from scanner.decoding.light.frame_checks import (
    FRAMES_CONTRADICT,
    LEFT_BY_SWAP,
    MOST_BROKEN,
    anomaly,
    check_frames,
    suspected,
)
from scanner.decoding.light.samples import MOST_ALONG, TILE_PX, GridSample, PartOfFrames, Sample, Samples, TileSample
