"""Linear equations for the shift of the camera's picture in every frame, from the slopes of the frames themselves.

To first order, a shift by d changes a frame I by −∇I · d: that of the fringes and that of the texture.
"""

from functools import reduce

import numpy as np

from calib.numerics import LEVEL, SLOPE, Floats, Floats32
from scanner.decoding.light.noise_model import NoiseModel
from scanner.decoding.motion.frame_equations import FrameEquations, of_frames
from scanner.decoding.motion.fringe_frames import FringeFrames
from scanner.decoding.motion.fringe_model import FringeModel
from scanner.decoding.motion.pixels import Pixels
from scanner.decoding.samples import TILE_PX, TileSample

# Noise reduction by the taps along both axes, as a factor of the variance.
_LESS_NOISE = float(np.sum(LEVEL**2)) ** 2
_MARGIN = len(LEVEL) // 2


def equations_of_shifts(frames: FringeFrames, tiles: TileSample, pixels: Pixels, noise: NoiseModel) -> FrameEquations:
    """Return the equations for the shift of each frame to the right and down."""
    row, column = np.divmod(pixels.number % TILE_PX**2, TILE_PX)
    inside = (np.minimum(row, column) >= _MARGIN) & (np.maximum(row, column) < TILE_PX - _MARGIN)
    images = tiles.of_frames(frames.times.tolist())
    place = pixels.number[inside]
    levels, right, down = (
        _filtered(images, *taps)[:, place] for taps in ((LEVEL, LEVEL), (LEVEL, SLOPE), (SLOPE, LEVEL))
    )
    model = FringeModel(frames, levels.astype(np.float64))
    variance = _LESS_NOISE * noise.variance(model.light).astype(np.float64)
    return FrameEquations(frames, pixels.tile[inside], (of_frames(model, -np.stack([right, down]), variance),))


def _filtered(images: Floats32, down: Floats, across: Floats) -> Floats32:
    """Filter tiles (N, P) by taps along columns and rows; values within two pixels of a tile's border are undefined."""
    filtered = images.reshape(len(images), -1, TILE_PX, TILE_PX)
    # A matrix product of a few taps made OpenBLAS warn of invalid values that do not exist.
    for axis, taps in ((2, down), (3, across)):
        shifted = (tap * np.roll(filtered, _MARGIN - k, axis) for k, tap in enumerate(taps.astype(np.float32)))
        filtered = reduce(np.add, shifted)
    return filtered.reshape(images.shape)
