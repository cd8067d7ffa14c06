"""Projector coordinates of all pixels: from code words and phases to a map with variances and mask reasons."""

from scanner.decoding.coordinates.axis_decoder import FringeAxis, UnwrappedFringes
from scanner.decoding.coordinates.code_images import CodeImages, Signals
from scanner.decoding.coordinates.coordinate_map import SMALLEST_PATCH, CoordinateMap
from scanner.decoding.coordinates.decoder_calibration import agreeing
