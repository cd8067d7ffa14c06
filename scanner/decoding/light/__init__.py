"""Brightness of frames and pixels: noise, flicker, response curve, exposure fusion, ghosting."""

from scanner.decoding.light.lit_pixels import LIT
from scanner.decoding.light.noise_model import STRAY_PART, NoiseModel
