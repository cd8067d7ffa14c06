"""Brightness of frames and pixels: noise, flicker, response curve, exposure fusion, ghosting."""

from scanner.decoding.light.noise_model import STRAY_PART, NoiseModel
