"""Grey levels: samples of the frames, their noise, brightness and exposure, and what the light of all must satisfy."""

from scanner.decoding.light.ambient_light_change import AmbientLightChange, without_change
from scanner.decoding.light.brightness import (
    BANDS,
    LEAST_DIFFERENCE,
    PASSES,
    Gains,
    LitRows,
    gains_of_fringe,
    gains_of_pair,
    residual_of_gains,
    starts_of_bands,
)
from scanner.decoding.light.exposures import LIT, lit_by, saturation_level, unclipped
from scanner.decoding.light.photometric_constraints import (
    FRAMES_CONTRADICT,
    LEFT_BY_SWAP,
    MOST_BROKEN,
    STATIC_SHARE,
    anomaly,
    find_violations,
    frames_of_fine_bits,
    suspected,
)
from scanner.decoding.light.samples import (
    MOST_ALONG,
    STRAY_PART,
    TILE_PX,
    GridSample,
    NoiseModel,
    Sample,
    TileSample,
    measure_noise,
)
