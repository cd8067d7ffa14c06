"""Grey levels: samples of the frames, lit and clipped pixels, several exposures, brightness of frames, noise."""

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
from scanner.decoding.light.noise_model import STRAY_PART, NoiseModel, measure_noise
from scanner.decoding.light.samples import MOST_ALONG, TILE_PX, GridSample, Sample, TileSample
